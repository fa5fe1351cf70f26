"""The road and a MED's slots, to scale."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from docs.figures.look import BLUE, GREEN, SKY
from medjax.charging.docking import Partner, charging_slot_lane, charging_slot_x
from medjax.world.kinds import HUMAN_EV, MED
from medjax.world.params import CHARGING_SLOTS, EnvParams
from train.reporting.figures import new_figure, save

ASPHALT, LINE = "#D9D9D9", "#FFFFFF"


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
    axes.set(xlim=(-160, length + 160), ylim=(lanes + 2.8, -0.8))
    axes.set_yticks([0, 1, 2, 3, 4], ["0, left", "1", "2, MEDs", "3, right", "4, ramps"])
    _bare(axes, "position x (m); the width is not to scale")


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
    for charging_slot, name in enumerate(CHARGING_SLOTS):
        length = lengths[HUMAN_EV]
        front = float(charging_slot_x(jnp.asarray(charging_slot), med, length, gap))
        beside = int(charging_slot_lane(jnp.asarray(charging_slot), med.lane))
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
    axes.set(xlim=(-34, 22), ylim=((lane + 1.5) * width, (lane - 1.5) * width))
    axes.set_yticks(np.arange(lane - 1, lane + 2) * width, [str(lane + i) for i in (-1, 0, 1)])
    _bare(axes, "distance from the MED's front bumper (m)")


def _arrow(axes: Any, start: Any, end: Any, style: str = "-|>") -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": style, "color": "black", "lw": 1.2})


def _bare(axes: Any, along: str) -> None:
    axes.set(xlabel=along, ylabel="lane")
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)
