"""Mutual inductance and efficiency of misaligned coils."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from docs.figures.look import CURVES
from medjax.charging.link import Misalignment, couple, misalignment
from medjax.physics import mutual_inductance
from medjax.world.params import RIGHT, EnvParams
from train.reporting.figures import new_figure, save

GAPS_M = (0.1, 0.2, 0.3, 0.5)
LATERAL = "lateral offset d (m)"


def draw_inductance(path: Path, params: EnvParams) -> None:
    """Mutual inductance over lateral offset: curves for some gaps, and a map."""
    coils = medjax.scenarios.CoilDesign()

    @jax.jit
    def microhenry(axial: Any, lateral: Any) -> jax.Array:
        radii, turns = (coils.med_coil_radius_m, coils.ev_coil_radius_m), coils.med_coil_turns
        where = axial, lateral, 0.0
        return 1e6 * mutual_inductance(
            *radii, *where, primary_turns=turns, secondary_turns=coils.ev_coil_turns
        )

    figure = new_figure(8.5, 3.8)
    curves, plane = figure.subplots(1, 2)
    lateral = np.linspace(0, 1.2, 241)
    for (color, style), gap in zip(CURVES, GAPS_M, strict=True):
        values = microhenry(gap, lateral)
        curves.plot(lateral, values, color=color, ls=style, lw=2, label=f"{gap} m")
    curves.axhline(0, color="black", lw=1)
    curves.legend(title="axial distance")
    curves.grid(alpha=0.3)
    curves.set(xlim=(0, 1.2), xlabel=LATERAL, ylabel="mutual inductance M (µH)")
    across, axial = np.meshgrid(lateral, np.linspace(0.1, 1.0, 91))
    levels = (-8, -4, -2, -1, -0.5, 0, 0.5, 1, 2, 4, 8, 16, 32, 64)
    values = microhenry(axial, across)
    from matplotlib.colors import SymLogNorm

    norm = SymLogNorm(0.5, vmin=-64, vmax=64)
    filled = plane.contourf(across, axial, values, levels, cmap="PuOr", norm=norm)
    plane.contour(across, axial, values, [0.0], colors="black", linewidths=2)
    plane.set(xlabel=LATERAL, ylabel="axial distance c (m)")
    figure.colorbar(filled, ax=plane, ticks=levels, label="M (µH); line: the null")
    save(figure, path)


def draw_efficiency(path: Path, params: EnvParams) -> None:
    """Efficiency of the link over misalignment: curves for some gaps, and a side slot from above."""
    figure = new_figure(8.5, 3.8)
    curves, plane = figure.subplots(1, 2)
    efficiency_at = jax.jit(lambda seen, link: couple(seen, link).efficiency)
    lateral = np.linspace(0, 0.9, 181)
    for (color, style), gap in zip(CURVES, GAPS_M, strict=True):
        seen = Misalignment(jnp.full(lateral.shape, gap), jnp.asarray(lateral), jnp.zeros(()))
        efficiency = efficiency_at(seen, params.link)
        curves.plot(lateral, efficiency, color=color, ls=style, lw=2, label=f"{gap} m")
    for kind in ("dock", "hold"):
        tolerance = float(getattr(params.charging, f"{kind}_tolerance_m"))
        curves.axvline(tolerance, color="black", lw=1)
        curves.text(tolerance + 0.01, 1.02, f"{kind}s ≤ {tolerance:.1f} m", size=8, va="bottom")
    curves.set(xlabel=LATERAL, ylabel="efficiency of the link", xlim=(0, 0.9), ylim=(0, 1.09))
    curves.grid(alpha=0.3)
    small = {"fontsize": "small", "title_fontsize": "small"}
    curves.legend(title="axial distance", loc="lower left", **small)
    along, across = np.meshgrid(np.linspace(-0.7, 0.7, 141), np.linspace(-0.15, 0.6, 76))
    charging_slot, straight = jnp.full(along.shape, RIGHT), jnp.zeros(along.shape)
    place = jnp.asarray(along), jnp.asarray(across)
    geometry = misalignment(charging_slot, *place, straight, params.link.panel_gap_m)
    levels = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1)
    values = efficiency_at(geometry, params.link)
    filled = plane.contourf(along, across, values, levels, cmap="cividis")
    plane.plot(0, 0, marker="x", color="black", ms=8, mew=2)
    below = {"textcoords": "offset points", "ha": "center", "va": "top"}
    plane.annotate("nominal place", (0, 0), (0, -6), **below)
    plane.set(xlabel="EV ahead of its slot (m)", ylabel="EV further out than its slot (m)")
    plane.set_title("right slot, no difference of headings", fontsize="medium")
    figure.colorbar(filled, ax=plane, ticks=levels, label="efficiency of the link")
    save(figure, path)
