"""The picture of `benchmarks.studies.generalization`: gains over the demand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from medjax.policies.rules import BASELINES
from train.reporting.figures import MARKERS, colour, new_figure, save

# For trained runs; of Okabe and Ito (2008) those that train.reporting.figures gives to few rules; markers differ too.
RUN_COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#000000")


def plot_gains(
    path: Path,
    factors: Sequence[float],
    gains: Mapping[str, Sequence[Any]],
    vehicles_per_h: float,
) -> None:
    """Draws what each policy gains on no action over the demand, rules dashed, as a PNG.

    Args:
        path: file to write.
        factors: multiples of the demand.
        gains: by policy, one for each factor: `mean` and `ci95`.
        vehicles_per_h: demand of factor 1.
    """
    figure = new_figure(8, 5)
    axes = figure.add_subplot()
    for number, (name, each) in enumerate(gains.items()):
        means = np.array([gain["mean"] for gain in each])
        low, high = np.array([gain["ci95"] for gain in each]).T
        is_rule = name in BASELINES
        axes.errorbar(
            factors,
            means,
            yerr=(means - low, high - means),
            color=colour(name) if is_rule else RUN_COLOURS[number % len(RUN_COLOURS)],
            marker=MARKERS[number % len(MARKERS)],
            ls="--" if is_rule else "-",
            capsize=3,
            label=name,
        )
    axes.axhline(0.0, color="0.5", lw=1)
    axes.set_xticks(factors)
    axes.set_xlabel(f"demand, multiples of {vehicles_per_h:.0f} vehicles/h")
    axes.set_ylabel("return of an episode minus that of no action, 95 % CI")
    axes.set_title("Other demands than the preset's")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small", frameon=False)
    save(figure, path)
