"""The figure of `--plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from medjax.files import replacing

COLORS = {"medjax": "#00796b", "medjax IDM": "#5e92f3", "SUMO": "#e65100"}


def draw(path: Path, result: dict[str, Any]) -> None:
    """Draws the fundamental diagram, the rising demand and merging as a PNG.

    Args:
      path: of the file.
      result: of `compare.compare`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    (by_density, by_flow), (rising, merging) = figure.subplots(2, 2)
    for name in result["simulators"]:
        flow, density = _points(result, name)
        speed = flow / np.maximum(density, 1e-9) / 3.6
        style = {"s": 4, "alpha": 0.4, "color": COLORS[name], "label": name, "linewidths": 0}
        by_density.scatter(density, flow, **style)
        by_flow.scatter(flow, speed, **style)
        _draw_rising(rising, result, name)
        _draw_merging(merging, result, name)
    by_density.axhspan(1900, 2400, color="0.5", alpha=0.15, label="capacity, published")
    by_density.set(
        xlabel="vehicles/km/lane", ylabel="vehicles/h/lane", title="5 minutes, a detector and lane"
    )
    by_flow.set(xlabel="vehicles/h/lane", ylabel="m/s", title="the same")
    rising.set(
        xlabel="minute", ylabel="vehicles/h/lane", title="behind the last ramp, rising demand"
    )
    merging.axhline(0.85, color="0.5", linestyle="--", label="goal")
    merging.set(
        xlabel="demand", ylabel="merging speed / right lane's", title="median and 5th percentile"
    )
    for axes in (by_density, rising, merging):
        if axes.has_data():  # the rising demand may not be measured
            axes.legend(frameon=False)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=110)


def _points(result: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Flow and density of all demands, where there were vehicles."""
    diagrams = [of[name] for of in result["diagram"].values()]
    flow = np.concatenate([np.ravel(each["flow"]) for each in diagrams])
    density = np.concatenate([np.ravel(each["density"]) for each in diagrams])
    return flow[density > 0.0], density[density > 0.0]


def _draw_rising(axes: Any, result: dict[str, Any], name: str) -> None:
    if "rising" in result["history"]:
        flow = result["history"]["rising"][name]["flow"]
        axes.plot(range(1, len(flow) + 1), flow, color=COLORS[name], label=name)


def _draw_merging(axes: Any, result: dict[str, Any], name: str) -> None:
    demands = list(result["figures"])
    for figure, marker in (
        ("merge_relative_speed_median", "o-"),
        ("merge_relative_speed_p5", "v:"),
    ):
        values = [result["figures"][demand][name][figure] for demand in demands]
        values = [np.nan if value is None else value for value in values]
        label = name if marker == "o-" else None
        axes.plot(demands, values, marker, color=COLORS[name], label=label)
