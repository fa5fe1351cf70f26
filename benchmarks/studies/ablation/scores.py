"""What the studies share: settings of the environment, rows of a report, and how they are shown."""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from medjax.commandline import parse_overrides
from medjax.episodes.scores import Scores
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.tables import interval, short
from train.reporting.figures import MARKERS, colour, save
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play
from train.settings import TrainConfig

RULES = ("budgeted", "forecast", "paced", "greedy", "slow", "none")


@dataclasses.dataclass(frozen=True)
class Column:
    """A metric as tables and figures show it."""

    metric: str
    heading: str
    axis: str  # with its unit
    with_interval: bool = False


def settings(options: argparse.Namespace) -> TrainConfig:
    """Those of the run that is given, else the default ones; with the environment that is asked for.

    Raises:
      InputError: there is no such run, or a `--set` that cannot be read.
    """
    run_dir = getattr(options, "run_dir", None)
    config = RunDir(run_dir).load_config() if run_dir else PPOConfig(seed=options.seed)
    return to_play(config, options.scenario, parse_overrides(options.overrides))


def rules(env: Any) -> dict[str, Policy]:
    """The policies that are not learned, by name."""
    return {name: BASELINES[name](env) for name in RULES}


def in_world(score: Scores, index: int) -> Scores:
    """Scores `(episodes,)` in one world out of those of all `(worlds, episodes)`."""
    return {metric: values[index] for metric, values in score.items()}


def describe(score: Scores, columns: Sequence[Column], seed: int) -> dict[str, Any]:
    """Means of all metrics over the episodes, as METRIC, and the intervals that are shown, as METRIC_ci95."""
    row: dict[str, Any] = {metric: float(values.mean()) for metric, values in score.items()}
    for column in columns:
        if column.with_interval:
            row[f"{column.metric}_ci95"] = list(bootstrap_ci95(score[column.metric], seed))
    return row


def headings(columns: Sequence[Column]) -> list[str]:
    """Those of `cells`."""
    return [
        text for each in columns for text in (each.heading, "95 % CI")[: 1 + each.with_interval]
    ]


def cells(row: Mapping[str, Any], columns: Sequence[Column]) -> list[str]:
    """What is shown of a row."""
    shown = []
    for column in columns:
        shown.append(short(row[column.metric]))
        if column.with_interval:
            shown.append(interval(row[f"{column.metric}_ci95"]))
    return shown


def finish(
    figure: Any, panels: Mapping[Any, tuple[str, str]], title: str, columns: int, path: Path
) -> None:
    """Labels the panels, puts one legend under all of them, and writes the PNG.

    Args:
      panels: what stands at the axes of each: x and y; they show the same policies.
      columns: of the legend, at most.
    """
    for axes, (x, y) in panels.items():
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        axes.grid(alpha=0.3)
    handles, labels = next(iter(panels)).get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(columns, len(labels)))
    figure.suptitle(title)
    save(figure, path)


def draw_rows(
    axes: Any, rows: Sequence[Mapping[str, Any]], x: str, y: str, label: str, number: int, ls: str
) -> None:
    """Means of rows of one policy, with the intervals that they have along either axis.

    Args:
      rows: of the report; `x` and `y` are drawn of them.
      number: of the policy, for its marker.
      ls: style of the line between the rows.
    """
    errors = {}
    for name, metric in (("xerr", x), ("yerr", y)):
        if f"{metric}_ci95" in rows[0]:
            low = [row[metric] - row[f"{metric}_ci95"][0] for row in rows]
            high = [row[f"{metric}_ci95"][1] - row[metric] for row in rows]
            errors[name] = (low, high)
    axes.errorbar(
        [row[x] for row in rows],
        [row[y] for row in rows],
        color=colour(rows[0]["policy"]),
        marker=MARKERS[number % len(MARKERS)],
        ls=ls,
        capsize=3,
        label=label,
        **errors,
    )
