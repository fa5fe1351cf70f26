"""What studies share: the world and policies that they play, rows with paired intervals, and their table."""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.command import a_path
from medjax.commandline import parse_overrides
from medjax.episodes.scores import Scores
from medjax.errors import InputError
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.environments import make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.tables import SAMPLED, format_rows, interval, short
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play
from train.settings import TrainConfig

RULES = ("budgeted", "forecast", "paced", "greedy", "slow", "none")


@dataclasses.dataclass(frozen=True)
class Column:
    """A metric as tables and figures show it."""

    metric: str
    heading: str
    axis: str = ""  # of figures, with the unit
    with_interval: bool = False


def add_run_dir(parser: argparse.ArgumentParser, text: str) -> None:
    """Adds `--run-dir`; without `--scenario` the run's preset is played, or the default of train.ppo."""
    parser.set_defaults(scenario=None)
    parser.add_argument("--run-dir", type=a_path, metavar="DIR", help=text)


def settings(options: argparse.Namespace) -> TrainConfig:
    """Settings of the given run, else the default ones, in the requested environment.

    Raises:
      InputError: there is no such run, or a `--set` cannot be read.
    """
    run_dir = getattr(options, "run_dir", None)
    config = RunDir(run_dir).load_config() if run_dir else PPOConfig(seed=options.seed)
    changes = parse_overrides(getattr(options, "overrides", []))
    return to_play(config, options.scenario, changes)


def dispatcher_settings(options: argparse.Namespace) -> TrainConfig:
    """`settings`; InputError as there, or if the run is of agents."""
    config = settings(options)
    if config.agents != "none":
        raise InputError(f"--run-dir {options.run_dir} is of agents, allowed: of a dispatcher")
    return config


def load(
    options: argparse.Namespace, config: TrainConfig, stochastic: bool = False
) -> tuple[Any, Any, dict[str, Policy]]:
    """Environment, parameters, and policies by name: those of `--run-dir`, if given, and all rules.

    Raises:
      InputError: the run cannot be read, or does not fit the environment; or there is no run to sample from.
    """
    if options.run_dir:
        env, params, found = load_policies(options.run_dir, config)
        played = {
            name.removesuffix(SAMPLED): policy
            for name, policy in found.items()
            if name in BASELINES or name.endswith(SAMPLED) == stochastic
        }
        return env, params, played
    if stochastic:
        raise InputError("--stochastic without --run-dir, allowed: with it")
    env, params = make_environment(config)
    return env, params, rules(env, BASELINES)


def rules(env: Any, names: Sequence[str] | Mapping[str, Any] = RULES) -> dict[str, Policy]:
    """Policies that are not learned, by name."""
    return {name: BASELINES[name](env) for name in names}


def estimate(values: np.ndarray, seed: int) -> dict[str, Any]:
    """Mean of values `(episodes,)` and its bootstrap interval: `mean`, `ci95`."""
    return {"mean": float(np.mean(values)), "ci95": list(bootstrap_ci95(values, seed))}


def format_estimate(found: Mapping[str, Any]) -> str:
    """What `estimate` returns, as text."""
    return f"{short(found['mean'])} {interval(found['ci95'])}"


def describe(
    score: Scores, columns: Sequence[Column], seed: int, base: Scores | None = None
) -> dict[str, Any]:
    """A row of a report.

    Args:
      score: `(episodes,)` each.
      columns: those with an interval add METRIC_ci95.
      seed: of the bootstrap.
      base: scores of the same episodes, which add return_change, the difference from them, and return_change_ci95.

    Returns:
      Means of all metrics by name, and the intervals.
    """
    row: dict[str, Any] = {metric: float(np.mean(values)) for metric, values in score.items()}
    for column in columns:
        if column.with_interval:
            row[f"{column.metric}_ci95"] = list(bootstrap_ci95(score[column.metric], seed))
    if base is not None:
        change = estimate(score["return"] - base["return"], seed)
        row |= {"return_change": change["mean"], "return_change_ci95": change["ci95"]}
    return row


def table_of(
    rows: Sequence[Mapping[str, Any]],
    labels: Mapping[str, str],
    columns: Sequence[Column],
    base: tuple[str, Any] | None = None,
) -> str:
    """Rows of `describe` as text.

    Args:
      rows: with their labels.
      labels: keys of the labels, by heading.
      columns: metrics to show.
      base: key and value of the label of the rows that the others are compared with; adds the change in return.
    """
    table = [[*labels]]
    for column in columns:
        table[0] += [column.heading, "95 % CI"][: 1 + column.with_interval]
    if base:
        than = base[1] if isinstance(base[1], str) else f"at {base[1]:g}"
        table[0].append(f"return minus {than}, 95 % CI")
    for row in rows:
        named = (row.get(key, "-") for key in labels.values())
        cells = [label if isinstance(label, str) else f"{label:g}" for label in named]
        for column in columns:
            cells.append(short(row[column.metric]))
            if column.with_interval:
                cells.append(interval(row[f"{column.metric}_ci95"]))
        if base:
            change = {"mean": row["return_change"], "ci95": row["return_change_ci95"]}
            cells.append("" if row[base[0]] == base[1] else format_estimate(change))
        table.append(cells)
    return format_rows(table)
