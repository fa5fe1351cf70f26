"""Policies in worlds that differ in one number."""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import a_path, non_negative
from benchmarks.studies.ablation.scores import (
    Column,
    cells,
    describe,
    draw_rows,
    finish,
    headings,
    in_world,
    rules,
    settings,
)
from benchmarks.studies.ablation.side_by_side import play_worlds
from medjax.commandline import OneLineParser
from medjax.episodes.scores import Scores
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.environments import check_environment, make_environment
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.tables import format_rows, interval, short
from train.reporting.figures import new_figure
from train.runs.policies import load_policies


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A number of the world, and the values that it takes."""

    number: str  # as medjax.make takes it, group included
    values: tuple[float, ...]
    label: str  # with its unit
    note: str


SWEEPS = {
    "misalignment": Sweep(
        "link.misalignment_scale",
        (0, 0.5, 1, 2),
        "share of the misalignment that coils see",
        "Varies the coils' misalignment: none (0, all links at their nominal place), as simulated (1), twice that (2).",
    ),
    "humans": Sweep(
        "demand.human_share",
        (0, 0.25, 0.5, 0.75, 1),
        "share of EVs with a human driver",
        "Varies the share of EVs with human drivers, and their noise, among autonomous EVs.",
    ),
    "cooldown": Sweep(
        "fleet.cooldown_s",
        (5, 10, 20, 30, 40, 60),
        "cooldown after a dispatch (s)",
        "Varies the time after a dispatch in which no other MED can be sent.",
    ),
    "fleet": Sweep(
        "fleet.size",
        (0, 3, 6, 9, 12, 15),
        "MEDs in the fleet",
        "Varies the number of MEDs. For more than the preset has slots for: --set num_meds=30 --values 15 20 30.",
    ),
    "power": Sweep(
        "charging.slot_power_w",
        (5e3, 10e3, 20e3, 40e3, 80e3, 160e3),
        "power of each of a MED's slots (W)",
        "Varies the power of a slot from a quarter to eight times that of `corridor`: --scenario corridor.",
    ),
}
COLUMNS = (
    Column("return", "return", "return of an episode", True),
    Column("depleted_share", "depleted share", "share of EVs that run out", True),
    Column("meds_dispatched", "MEDs sent", "MEDs sent in an episode"),
    Column("energy_delivered_kwh", "kWh delivered", "energy delivered in an episode (kWh)"),
    Column("energy_lost_kwh", "lost", "energy lost in an episode (kWh)"),
    Column("mean_soc", "mean SoC", "mean state of charge"),
)


def add_options(parser: OneLineParser, study: str) -> None:
    """Options of these studies only."""
    label, values = SWEEPS[study].label, SWEEPS[study].values
    shown = f"{label} (default: {' '.join(map(str, values))})"
    parser.add_argument(
        "--values", type=non_negative, nargs="+", default=values, metavar="X", help=shown
    )
    parser.add_argument(
        "--run-dir",
        type=a_path,
        metavar="DIR",
        help="also play the policy of this directory, which train.ppo wrote",
    )


def run(study: str, options: argparse.Namespace) -> dict[str, Any]:
    """Plays all policies at all values, prints a table, and returns it: what was varied, a row a policy and value.

    Raises:
      InputError: a value that is not allowed, or a run that cannot be read.
    """
    sweep, config = SWEEPS[study], settings(options)
    values = [int(value) if value == int(value) else value for value in options.values]
    for value in values:  # refuses those that are not allowed
        overrides = {**config.overrides, sweep.number: value}
        check_environment(dataclasses.replace(config, overrides=overrides))
    found: dict[str, Policy] = {}
    if options.run_dir:
        env, params, found = load_policies(options.run_dir, config, options.stochastic)
    else:
        env, params = make_environment(config)
    policies = {name: found[name] for name in found if name not in BASELINES} | rules(env)
    numbers = {sweep.number: np.asarray(values, np.float32)}
    scores = play_worlds(env, params, numbers, policies, options.episodes, options.seed)
    rows = []
    for name, score in scores.items():
        rows += rows_of(name, score, values, options.seed, COLUMNS)
    print(f"{config.scenario}, {options.episodes} episodes, seed {options.seed}: {sweep.label}")
    print(table_of(rows, values[0], COLUMNS))
    varied = {"study": study, "number": sweep.number, "label": sweep.label}
    played = {"episodes": options.episodes, "seed": options.seed}
    return {**varied, "scenario": config.scenario, **played, "rows": rows}


def rows_of(
    policy: str, score: Scores, values: Sequence[float], seed: int, columns: Sequence[Column]
) -> list[dict[str, Any]]:
    """A row for each value; return_change is the return less that of the same episodes at the first value.

    Args:
      score: arrays `(values, episodes)`.
      seed: of the intervals' bootstrap.
    """
    rows = []
    for index, value in enumerate(values):
        row = {"policy": policy, "value": value, **describe(in_world(score, index), columns, seed)}
        change = score["return"][index] - score["return"][0]
        row["return_change"] = float(change.mean())
        row["return_change_ci95"] = list(bootstrap_ci95(change, seed))
        rows.append(row)
    return rows


def table_of(rows: Sequence[dict[str, Any]], first: float, columns: Sequence[Column]) -> str:
    """The rows as text; `first` is the value that the others are compared with."""
    table = [["policy", "value", *headings(columns), f"return minus at {first}, 95 % CI"]]
    for row in rows:
        change = f"{short(row['return_change'])} {interval(row['return_change_ci95'])}"
        shown = change if row["value"] != first else ""
        table.append([row["policy"], str(row["value"]), *cells(row, columns), shown])
    return format_rows(table)


def plot(path: Path, report: dict[str, Any]) -> None:
    """Draws return and depleted share of the report of `run` over the values, a line a policy, as a PNG."""
    figure = new_figure(11, 4.8)
    of_policy: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(report["rows"], key=lambda row: row["value"]):
        of_policy.setdefault(row["policy"], []).append(row)
    panels = {}
    for axes, column in zip(figure.subplots(1, 2), COLUMNS[:2], strict=True):
        for number, (name, rows) in enumerate(of_policy.items()):
            draw_rows(axes, rows, "value", column.metric, name, number, "-")
        panels[axes] = report["label"], f"{column.axis}, 95 % CI"
    title = f"{report['scenario']}, {report['episodes']} episodes, the same for all"
    finish(figure, panels, title, 7, path)
