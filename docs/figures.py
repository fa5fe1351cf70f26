"""The figures of the models' pages, drawn by the functions that they are about.

    python -m docs.figures [DIRECTORY]      writes docs/images/*.png

from the repository's root; it needs the extra `train` for matplotlib.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from medjax.charging.docking import Partner, panel_lane, panel_x
from medjax.charging.energy import drive_energy
from medjax.charging.link import Misalignment, coupling_efficiency, misalignment
from medjax.physics import mutual_inductance
from medjax.traffic import idm_acceleration
from medjax.traffic.motion import lateral_step
from medjax.world.kinds import HUMAN_EV, MED
from medjax.world.params import PANELS, RIGHT, BodyParams, EnvParams
from train.reporting.figures import new_figure, save

ROOT = Path(__file__).parent.parent
# Okabe and Ito (2008), as in train/figures.py; line styles tell curves apart as well.
BLUE, ORANGE, GREEN, RED, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9"
CURVES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (RED, ":"))
GAPS_M = (0.1, 0.2, 0.3, 0.5)
ASPHALT, LINE = "#D9D9D9", "#FFFFFF"
JOULES_PER_KWH = 3.6e6


def draw_road(path: Path, params: EnvParams) -> None:
    """The highway with its ramps, and a MED with an EV in each of its slots, to scale."""
    figure = new_figure(8.5, 4.9)
    highway, platoon = figure.subplots(2, 1, height_ratios=(1.2, 1))
    _draw_highway(highway, params)
    _draw_platoon(platoon, params)
    save(figure, path)


def _draw_highway(axes: Any, params: EnvParams) -> None:
    from matplotlib.patches import Rectangle

    length, lanes = float(params.road.length_m), 4
    axes.add_patch(Rectangle((0, -0.5), length, lanes, color=ASPHALT))
    for edge in np.arange(lanes - 1) + 0.5:
        axes.plot([0, length], [edge, edge], color=LINE, lw=1.5, ls=(0, (8, 8)))
    for number, x in enumerate(np.asarray(params.road.ramp_x_m), 1):
        merge = float(params.road.acceleration_lane_m)
        axes.add_patch(Rectangle((x, lanes - 0.5), merge, 1, color=SKY, lw=0))
        _arrow(axes, (x - 90, lanes + 1.15), (x + 30, lanes + 0.1))
        axes.text(x + 60, lanes + 0.8, f"ramp {number}\n{x:.0f} m", ha="left", va="top")
    for lane in range(lanes):
        _arrow(axes, (-120, lane), (-15, lane))
        _arrow(axes, (length + 15, lane), (length + 120, lane))
    axes.text(length / 2, 1, "driving direction →", ha="center", va="center", color="#333333")
    axes.set_xlim(-160, length + 160)
    axes.set_ylim(lanes + 2.8, -0.8)
    axes.set_yticks([0, 1, 2, 3, 4], ["0, left", "1", "2, MEDs", "3, right", "4, ramps"])
    axes.set_xlabel("position x (m); the width is not to scale")
    axes.set_ylabel("lane")
    _bare(axes)


def _draw_platoon(axes: Any, params: EnvParams) -> None:
    from matplotlib.patches import FancyBboxPatch, Rectangle

    width = float(params.road.lane_width_m)
    lengths = np.asarray(params.drivers.vehicle_length)
    lane = int(params.fleet.service_lane)
    med = Partner(jnp.zeros(()), jnp.zeros(()), jnp.asarray(lane), jnp.asarray(lengths[MED]))
    axes.add_patch(Rectangle((-34, (lane - 1.5) * width), 56, 3 * width, color=ASPHALT, lw=0))
    for edge in (lane - 0.5, lane + 0.5):
        axes.plot([-34, 22], [edge * width, edge * width], color=LINE, lw=1.5, ls=(0, (8, 8)))

    def vehicle(front: float, lane: float, length: float, breadth: float, color: str) -> None:
        corner = (front - length, lane * width - breadth / 2)
        style = "round,pad=0,rounding_size=0.4"
        axes.add_patch(FancyBboxPatch(corner, length, breadth, boxstyle=style, color=color, lw=0))

    vehicle(0.0, lane, lengths[MED], 2.5, GREEN)
    axes.text(-lengths[MED] / 2, lane * width, "MED", ha="center", va="center", color="white")
    gap = params.charging.dock_gap_m
    for panel, name in enumerate(PANELS):
        length = lengths[HUMAN_EV]
        front = float(panel_x(jnp.asarray(panel), med, length, gap))
        beside = int(panel_lane(jnp.asarray(panel), med.lane))
        vehicle(front, beside, length, 1.9, BLUE)
        middle, y = front - length / 2, beside * width
        axes.text(middle, y, "EV", ha="center", va="center", color="white", size=8)
        axes.text(middle, y + 1.05, f"{name} slot", ha="center", va="top", size=8)
    for start, side in ((0.0, 1), (-lengths[MED], -1)):
        end = start + side * float(gap)
        _arrow(axes, (start, lane * width + 1.55), (end, lane * width + 1.55), style="<->")
        label = f"{float(gap):.0f} m, panels on booms"
        axes.text((start + end) / 2, lane * width - 0.35, label, ha="center", va="bottom", size=8)
        axes.plot([start, end], [lane * width] * 2, color="black", lw=1.5)
    axes.set_aspect("equal")
    axes.set_xlim(-34, 22)
    axes.set_ylim((lane + 1.5) * width, (lane - 1.5) * width)
    axes.set_yticks(np.arange(lane - 1, lane + 2) * width, [str(lane + i) for i in (-1, 0, 1)])
    axes.set_xlabel("distance from the MED's front bumper (m)")
    axes.set_ylabel("lane")
    _bare(axes)


def _arrow(axes: Any, start: Any, end: Any, style: str = "-|>") -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": style, "color": "black", "lw": 1.2})


def _bare(axes: Any) -> None:
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(left=False)


def draw_idm(path: Path, params: EnvParams) -> None:
    """IDM acceleration over gap and speed: behind one who is as fast, and behind a MED."""
    from matplotlib.colors import TwoSlopeNorm

    drivers, figure = params.drivers, new_figure(8.5, 3.9)
    gap, speed = np.meshgrid(np.linspace(2, 120, 237), np.linspace(0, 35, 141))
    service = float(params.fleet.service_speed)
    panels = {
        "the vehicle ahead is as fast": speed,
        f"the vehicle ahead drives {service:.0f} m/s, as a MED": np.full_like(speed, service),
    }
    levels = (-9, -6, -4, -2, -1, -0.5, 0, 0.5, 1, 1.4)
    for axes, (title, leader) in zip(
        figure.subplots(1, 2, sharex=True, sharey=True), panels.items(), strict=True
    ):
        acceleration = idm_acceleration(
            speed,
            gap,
            leader,
            desired_speed=drivers.desired_speed[HUMAN_EV],
            time_headway=drivers.time_headway[HUMAN_EV],
            min_gap=drivers.min_gap[HUMAN_EV],
            max_acceleration=drivers.max_acceleration[HUMAN_EV],
            comfortable_deceleration=drivers.comfortable_deceleration[HUMAN_EV],
        )
        values = np.clip(acceleration, levels[0], levels[-1])
        norm = TwoSlopeNorm(0.0, levels[0], levels[-1])
        filled = axes.contourf(gap, speed, values, levels, cmap="PuOr", norm=norm)
        axes.contour(gap, speed, values, [0.0], colors="black", linewidths=2)
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("gap, bumper to bumper (m)")
    figure.axes[0].set_ylabel("speed (m/s)")
    bar = figure.colorbar(filled, ax=figure.axes[:2], ticks=levels)
    bar.set_label("acceleration (m/s²), at least −9; line: 0")
    save(figure, path)


def draw_lane_change(path: Path, params: EnvParams) -> None:
    """A lane change: distance to the new lane's centre and heading over time."""
    step, rate = 0.05, params.motion.lateral_rate
    offset, drift = jnp.asarray(params.road.lane_width_m), jnp.zeros(())
    track = []
    for _ in range(81):
        track.append((float(offset), float(drift)))
        offset, drift = lateral_step(offset, drift, jnp.zeros(()), rate, step)
    times, (offsets, drifts) = np.arange(len(track)) * step, np.transpose(track)
    figure = new_figure(8.5, 3.2)
    left, right = figure.subplots(1, 2, sharex=True)
    left.plot(times, offsets, color=BLUE, lw=2)
    left.axhline(0.05 * offsets[0], color="black", lw=1, ls=":")
    left.text(4.0, 0.05 * offsets[0] + 0.08, "5 % left to go", ha="right", va="bottom")
    left.set_ylabel("distance to the new lane's centre (m)")
    for (color, style), speed in zip(CURVES, (18.0, 25.0, 30.0), strict=False):
        angle = np.degrees(np.arctan2(-drifts, speed))
        right.plot(times, angle, color=color, ls=style, lw=2, label=f"{speed:.0f} m/s")
    right.set_ylabel("heading against the road (°)")
    right.legend(title="speed")
    for axes in (left, right):
        axes.set_xlabel("time since the change (s)")
        axes.set_xlim(0, 4)
        axes.set_ylim(0)
        axes.grid(alpha=0.3)
    save(figure, path)


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
    efficiency_at = jax.jit(coupling_efficiency)
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


def draw_energy(path: Path, params: EnvParams) -> None:
    """Battery power of an EV over speed, and energy per distance beside FASTSim's."""
    speed = np.linspace(0.5, 40, 159)

    def kilowatt(body: BodyParams) -> np.ndarray:
        return np.asarray(drive_energy(jnp.asarray(speed), jnp.asarray(speed), body, 1.0)) / 1e3

    figure = new_figure(8.5, 3.8)
    power, distance = figure.subplots(1, 2)
    auxiliary = kilowatt(params.ev.replace(drag_coefficient=0.0, rolling_resistance=0.0))
    rolling = kilowatt(params.ev.replace(drag_coefficient=0.0))
    total = kilowatt(params.ev)
    shares = {
        "auxiliaries": (np.zeros_like(total), auxiliary, GREEN, "///"),
        "rolling resistance": (auxiliary, rolling, ORANGE, "\\\\\\"),
        "air drag": (rolling, total, SKY, ""),
    }
    for name, (low, high, color, hatch) in shares.items():
        look = {"facecolor": color, "edgecolor": "white", "hatch": hatch, "lw": 0}
        power.fill_between(speed, low, high, label=name, **look)
    power.plot(speed, total, color="black", lw=2)
    power.set_ylabel("power from an EV's battery (kW)")
    power.legend(loc="upper left")

    distance.plot(speed, total / speed / 3.6 * 100, color="black", lw=2, label="medjax")
    with (ROOT / "tests/data/ev_energy.csv").open(encoding="utf-8") as table:
        leaf = next(row for row in csv.DictReader(table) if row["vehicle"].startswith("Nissan"))
    known = [100, 110, 120, 130]
    use = [float(leaf[f"battery_kwh_per_100km_at_{kmh}kmh"]) for kmh in known]
    places = [kmh / 3.6 for kmh in known]
    distance.plot(places, use, "o", color=RED, ms=7, label="FASTSim 2.1.5, Nissan Leaf")
    for at in (float(params.fleet.service_speed), float(params.drivers.desired_speed[HUMAN_EV])):
        value = float(np.interp(at, speed, total / speed / 3.6 * 100))
        distance.plot([at, at], [0, value], color=BLUE, lw=1, ls="--")
        distance.annotate(
            f"{value:.1f} at {at:.0f} m/s",
            (at, value),
            (-6, 6),
            textcoords="offset points",
            ha="right",
            va="bottom",
            color=BLUE,
        )
    distance.set_ylabel("energy from an EV's battery (kWh/100 km)")
    distance.legend(loc="upper left", fontsize="small")
    for axes in (power, distance):
        axes.set_xlabel("steady speed (m/s)")
        axes.set_xlim(0, 40)
        axes.set_ylim(0)
        axes.grid(alpha=0.3)
    save(figure, path)


FIGURES: dict[str, Callable[[Path, EnvParams], None]] = {
    "road": draw_road,
    "idm": draw_idm,
    "lane_change": draw_lane_change,
    "inductance": draw_inductance,
    "efficiency": draw_efficiency,
    "energy": draw_energy,
}


def draw(directory: Path) -> list[Path]:
    """Draws all figures of the `paper` preset.

    Args:
      directory: where to; it is made.

    Returns:
      The files.
    """
    _, params = medjax.make("paper")
    paths = [directory / f"{name}.png" for name in FIGURES]
    for path, figure in zip(paths, FIGURES.values(), strict=True):
        figure(path, params)
    return paths


if __name__ == "__main__":
    for written in draw(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/images"):
        print(written)
