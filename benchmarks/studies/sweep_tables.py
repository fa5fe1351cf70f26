"""Tables and figure of `python -m benchmarks.sweep`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.base import estimate, format_estimate
from medjax.episodes.scores import Scores
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.statistics import (
    improvement_probability,
    interquartile_mean,
    seeds_ci95,
)
from train.evaluation.tables import SAMPLED
from train.reporting.figures import new_figure, save

LEARNER = PPOConfig.algorithm


def describe(
    rows: Sequence[Mapping[str, float]],
    played: Mapping[str, Sequence[Sequence[Scores]]],
    starts: Sequence[Scores],
    seed: int,
) -> list[dict[str, Any]]:
    """A row of the report for each combination.

    Differences are in the same episodes; `minus_start` is from the first seed's initial policy with the row's numbers,
    `starts`. Intervals are over seeds and episodes.
    """
    returns, sampled = (
        np.array([[score["return"] for score in seeds] for seeds in played[LEARNER + end]])
        for end in ("", SAMPLED)
    )  # (settings, seeds, episodes)

    def over_seeds(values: np.ndarray) -> dict[str, Any]:
        return {"mean": float(values.mean()), "ci95": list(seeds_ci95(values, seed))}

    found = []
    for index, numbers in enumerate(rows):
        means, usual = returns[index].mean(axis=1), returns[0].mean(axis=1)
        better, ends = improvement_probability(means, usual, seed)
        found.append(
            {
                "settings": dict(numbers),
                "return_means": means.tolist(),
                "return": over_seeds(returns[index]),
                "sampled": over_seeds(sampled[index]),
                "minus_sampled": over_seeds(returns[index] - sampled[index]),
                "minus_default": over_seeds(returns[index] - returns[0]),
                "minus_start": over_seeds(returns[index] - starts[index]["return"]),
                "probability_of_improvement": {"mean": better, "ci95": list(ends)},
            }
        )
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The combinations as cells; the default, in the first row, has nothing to be compared with."""
    varied = [*rows[0]["settings"]]
    headings = ("sampled", "mode minus sampled", "minus start", "minus default", "P(improves)")
    keys = (
        "sampled",
        "minus_sampled",
        "minus_start",
        "minus_default",
        "probability_of_improvement",
    )
    cells = [[*varied, "return", *headings]]
    for number, row in enumerate(rows):
        own = [f"{row['settings'][name]:g}" for name in varied]
        shown_keys = keys if number else keys[:3]
        cells.append(
            [
                *own,
                format_estimate(row["return"]),
                *(format_estimate(row[key]) for key in shown_keys),
            ]
        )
        cells[-1] += [""] * (len(cells[0]) - len(cells[-1]))
    return cells


def other_rows(others: Mapping[str, Scores], seed: int) -> list[list[str]]:
    """Returns of the default's initial policy and the rules as cells, the best first."""
    means = sorted(others.items(), key=lambda item: -item[1]["return"].mean())
    cells = [[name, format_estimate(estimate(score["return"], seed))] for name, score in means]
    return [["not learned", "return, 95 % CI"], *cells]


def plot(path: Path, report: Mapping[str, Any]) -> None:
    """Draws the report as a PNG: learning curves, each seed's return, and probabilities of improvement."""
    figure = new_figure(13, 4.5)
    curves, ends, chances = figure.subplots(1, 3)
    curve = np.array(report["curve"], float)  # None becomes NaN
    steps = np.linspace(0, report["decisions"], len(curve) + 1)[1:]
    labels = [
        ", ".join(f"{name} {value:g}" for name, value in row["settings"].items())
        for row in report["rows"]
    ]
    for index, (row, label) in enumerate(zip(report["rows"], labels, strict=True)):
        there = np.isfinite(curve[:, index]).all(axis=1)
        middle = interquartile_mean(curve[there, index])
        (line,) = curves.plot(steps[there], middle, label=label, lw=1.5)
        ends.plot(
            row["return_means"],
            [index] * len(row["return_means"]),
            "o",
            color=line.get_color(),
            alpha=0.5,
        )
        _whisker(ends, row["return"], index, line.get_color())
        if index:
            _whisker(chances, row["probability_of_improvement"], index, line.get_color())
    curves.set(xlabel="decisions", ylabel="mean return of the episodes that ended")
    ends.set(xlabel="return, most probable action", yticks=range(len(labels)), yticklabels=labels)
    chances.axvline(0.5, color="black", lw=1, ls="--")
    chances.set(xlabel="probability of improvement over the default", xlim=(-0.05, 1.05), yticks=[])
    chances.set_ylim(ends.get_ylim())
    for axes in (curves, ends, chances):
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{report['scenario']}, {report['config']['num_seeds']} seeds, {report['decisions']:,} decisions each"
    )
    save(figure, path)


def _whisker(axes: Any, found: Mapping[str, Any], height: int, colour: str) -> None:
    """A mean with its interval."""
    low, high = found["ci95"]
    errors = [[found["mean"] - low], [high - found["mean"]]]
    axes.errorbar([found["mean"]], [height], xerr=errors, fmt="D", capsize=4, color=colour)
