"""The figure of `--plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from medjax.files import replacing

COLORS = {"medjax": "#00796b", "medjax IDM": "#5e92f3", "SUMO": "#e65100"}


def draw(path: Path, result: dict[str, Any]) -> None:
    """Draws the fundamental diagram, the rising demand and merging of a result of `compare.compare` as a PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    (by_density, by_flow), (rising, merging) = figure.subplots(2, 2)
    for name in result["simulators"]:
        color = COLORS[name]
        flow, density = (
            np.concatenate([np.ravel(of[name][what]) for of in result["diagram"].values()])
            for what in ("flow", "density")
        )
        flow, density = flow[density > 0.0], density[density > 0.0]
        style = {"s": 4, "alpha": 0.4, "color": color, "label": name, "linewidths": 0}
        by_density.scatter(density, flow, **style)
        by_flow.scatter(flow, flow / density / 3.6, **style)
        if "rising" in result["history"]:  # only if this run measured it
            flow = result["history"]["rising"][name]["flow"]
            rising.plot(range(1, len(flow) + 1), flow, color=color, label=name)
        for percentile, marker, label in (("median", "o-", name), ("p5", "v:", None)):
            figures = {demand: of[name] for demand, of in result["figures"].items()}
            values = [of[f"merge_relative_speed_{percentile}"] for of in figures.values()]
            values = [np.nan if value is None else value for value in values]
            merging.plot(list(figures), values, marker, color=color, label=label)
    by_density.axhspan(1900, 2400, color="0.5", alpha=0.15, label="capacity, published")
    merging.axhline(0.85, color="0.5", linestyle="--", label="goal")
    flow_label = "vehicles/h/lane"
    by_density.set(xlabel="vehicles/km/lane", title="5 minutes, a detector and lane")
    by_flow.set(xlabel=flow_label, ylabel="m/s", title="the same")
    rising.set(xlabel="minute", title="behind the last ramp, rising demand")
    merging.set(xlabel="demand", title="median and 5th percentile")
    for axes, label in (
        (by_density, flow_label),
        (rising, flow_label),
        (merging, "merging speed / right lane's"),
    ):
        axes.set_ylabel(label)
        if axes.has_data():
            axes.legend(frameon=False)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=110)
