"""Policies in worlds that differ in one number."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import add_number, non_negative
from benchmarks.studies.ablation.side_by_side import in_world, play_worlds
from benchmarks.studies.base import (
    Column,
    add_run_dir,
    describe,
    load,
    rules,
    settings,
    table_of,
)
from benchmarks.studies.drawing import draw_rows, finish
from medjax.commandline import OneLineParser
from medjax.policies.rules import BASELINES
from train.algorithms.environments import check_environment
from train.reporting.figures import new_figure


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
LABELS = {"policy": "policy", "value": "value"}
COLUMNS = (
    Column("return", "return", "return of an episode", True),
    Column("depleted_share", "depleted share", "share of EVs that run out", True),
    Column("meds_dispatched", "MEDs sent"),
    Column("energy_delivered_kwh", "kWh delivered"),
    Column("energy_lost_kwh", "lost"),
    Column("mean_soc", "mean SoC"),
)


def add_options(parser: OneLineParser, study: str) -> None:
    """Adds the options of sweeps."""
    sweep = SWEEPS[study]
    add_number(parser, "--values", sweep.values, sweep.label, non_negative, nargs="+")
    add_run_dir(parser, "also play the policy of this directory, which train.ppo wrote")


def run(study: str, options: argparse.Namespace) -> dict[str, Any]:
    """Plays all policies at all values, prints a table, and returns it with one row per policy and value.

    `return_change` is the return minus that of the same episodes at the first value.

    Raises:
      InputError: a value that is not allowed, or a run that cannot be read.
    """
    sweep, config, seed = SWEEPS[study], settings(options), options.seed
    values = [int(value) if value == int(value) else value for value in options.values]
    for value in values:  # refuses those that are not allowed
        overrides = {**config.overrides, sweep.number: value}
        check_environment(dataclasses.replace(config, overrides=overrides))
    env, params, found = load(options, config, options.stochastic)
    learned = {name: policy for name, policy in found.items() if name not in BASELINES}
    numbers = {sweep.number: np.asarray(values, np.float32)}
    scores = play_worlds(env, params, numbers, learned | rules(env), options.episodes, seed)
    rows = [
        {"policy": name, "value": value}
        | describe(in_world(score, index), COLUMNS, seed, in_world(score, 0))
        for name, score in scores.items()
        for index, value in enumerate(values)
    ]
    print(f"{config.scenario}, {options.episodes} episodes, seed {seed}: {sweep.label}")
    print(table_of(rows, LABELS, COLUMNS, ("value", values[0])))
    varied = {"study": study, "number": sweep.number, "label": sweep.label}
    played = {"scenario": config.scenario, "episodes": options.episodes, "seed": seed}
    return {**varied, **played, "rows": rows}


def plot(path: Path, report: dict[str, Any]) -> None:
    """Draws return and depleted share of the report of `run` over the values, a line a policy, as a PNG."""
    figure = new_figure(11, 4.8)
    of_policy: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(report["rows"], key=lambda row: row["value"]):
        of_policy.setdefault(row["policy"], []).append(row)
    panels = {}
    for axes, column in zip(figure.subplots(1, 2), COLUMNS[:2], strict=True):
        for number, (name, rows) in enumerate(of_policy.items()):
            draw_rows(axes, rows, "value", column.metric, number, label=name)
        panels[axes] = report["label"], f"{column.axis}, 95 % CI"
    title = f"{report['scenario']}, {report['episodes']} episodes, the same for all"
    finish(figure, panels, title, 7, path)
