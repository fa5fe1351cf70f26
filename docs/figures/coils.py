"""What coils do where they are not face to face."""

from __future__ import annotations

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


def draw_inductance(path: Path, params: EnvParams) -> None:
    """Mutual inductance over lateral offset: curves for some gaps, and a map."""
    coils = medjax.scenarios.CoilDesign()

    @jax.jit
    def microhenry(axial: Any, lateral: Any) -> jax.Array:
        return 1e6 * mutual_inductance(
            coils.med_coil_radius_m,
            coils.ev_coil_radius_m,
            axial,
            lateral,
            0.0,
            primary_turns=coils.med_coil_turns,
            secondary_turns=coils.ev_coil_turns,
        )

    figure = new_figure(8.5, 3.8)
    curves, plane = figure.subplots(1, 2)
    lateral = np.linspace(0, 1.2, 241)
    for (color, style), gap in zip(CURVES, GAPS_M, strict=True):
        curves.plot(
            lateral, microhenry(gap, lateral), color=color, ls=style, lw=2, label=f"{gap} m"
        )
    curves.axhline(0, color="black", lw=1)
    curves.set_ylabel("mutual inductance M (µH)")
    curves.legend(title="axial distance")
    curves.grid(alpha=0.3)
    curves.set_xlim(0, 1.2)
    across, axial = np.meshgrid(lateral, np.linspace(0.1, 1.0, 91))
    levels = (-8, -4, -2, -1, -0.5, 0, 0.5, 1, 2, 4, 8, 16, 32, 64)
    values = microhenry(axial, across)
    from matplotlib.colors import SymLogNorm

    filled = plane.contourf(
        across, axial, values, levels, cmap="PuOr", norm=SymLogNorm(0.5, vmin=-64, vmax=64)
    )
    plane.contour(across, axial, values, [0.0], colors="black", linewidths=2)
    plane.set_ylabel("axial distance c (m)")
    figure.colorbar(filled, ax=plane, ticks=levels, label="M (µH); line: the null")
    for axes in (curves, plane):
        axes.set_xlabel("lateral offset d (m)")
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
    charging = params.charging
    for tolerance, name in (
        (charging.dock_tolerance_m, "docks ≤"),
        (charging.hold_tolerance_m, "holds ≤"),
    ):
        curves.axvline(float(tolerance), color="black", lw=1)
        curves.text(
            float(tolerance) + 0.01, 1.02, f"{name} {float(tolerance):.1f} m", size=8, va="bottom"
        )
    curves.set_xlabel("lateral offset d (m)")
    curves.set_ylabel("efficiency of the link")
    curves.set_ylim(0, 1.09)
    curves.set_xlim(0, 0.9)
    curves.grid(alpha=0.3)
    curves.legend(
        title="axial distance", loc="lower left", fontsize="small", title_fontsize="small"
    )
    along, across = np.meshgrid(np.linspace(-0.7, 0.7, 141), np.linspace(-0.15, 0.6, 76))
    geometry = misalignment(
        jnp.full(along.shape, RIGHT),
        jnp.asarray(along),
        jnp.asarray(across),
        jnp.zeros(along.shape),
        params.link.panel_gap_m,
    )
    levels = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1)
    values = efficiency_at(geometry, params.link)
    filled = plane.contourf(along, across, values, levels, cmap="cividis")
    plane.plot(0, 0, marker="x", color="black", ms=8, mew=2)
    plane.annotate(
        "nominal place", (0, 0), (0, -6), textcoords="offset points", ha="center", va="top"
    )
    plane.set_xlabel("EV ahead of its slot (m)")
    plane.set_ylabel("EV further out than its slot (m)")
    plane.set_title("right slot, no difference of headings", fontsize="medium")
    figure.colorbar(filled, ax=plane, ticks=levels, label="efficiency of the link")
    save(figure, path)
