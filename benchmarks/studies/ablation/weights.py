"""Dispatchers trained for rewards of other weights: what MEDs and traffic pay for fewer depleted EVs."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import add_number, non_negative
from benchmarks.studies.ablation.side_by_side import in_world, play_worlds, train_worlds
from benchmarks.studies.base import Column, describe, rules, settings, table_of
from benchmarks.studies.drawing import draw_rows, finish
from medjax.commandline import OneLineParser
from medjax.episodes.runner import episode_decisions
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from train.algorithms.environments import check_environment, make_environment
from train.algorithms.registry import algorithm_of
from train.reporting.figures import new_figure

NOTE = (
    "Trains one dispatcher per cost of a MED, without a cost of delay, and one per cost of delay, without a cost of a "
    "MED. Costs are weights of eq (10), like that of a depleted EV."
)
COSTS = {  # by reward term: default values, and what is paid for
    "dispatches": ((0.0, 10.0, 20.0, 30.0), "a MED sent"),
    "gas_delay": ((0.05, 0.1), "a second that a gas vehicle loses"),
}
LABELS = {"policy": "policy", "cost of a MED": "dispatches", "of a lost second": "gas_delay"}
LEFT = {"xytext": (-7, 5), "ha": "right"}  # of a point
COLUMNS = (
    Column("depleted_share", "depleted share", "share of EVs that run out", True),
    Column("meds_dispatched", "MEDs sent", "MEDs sent in an episode", True),
    Column("gas_mean_speed", "gas m/s", "mean speed of gas vehicles (m/s)", True),
    Column("mean_soc", "mean SoC"),
)


def add_options(parser: OneLineParser) -> None:
    """Adds the options of this study."""
    add_number(parser, "--decisions", 1_000_000, "decisions per learner")
    for term, (values, paid_for) in COSTS.items():
        option = f"--{term.replace('_', '-')}"
        add_number(parser, option, values, f"costs of {paid_for}", non_negative, nargs="*")


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Trains a dispatcher for each reward, plays them and the rules, prints a table, and returns it.

    A row per learner, then per rule; only learners' returns include the costs.

    Raises:
      InputError: a setting that is not allowed.
    """
    costs = [{"dispatches": cost, "gas_delay": 0.0} for cost in options.dispatches]
    costs += [{"dispatches": 0.0, "gas_delay": cost} for cost in options.gas_delay]
    if not costs:
        raise InputError("no cost in --dispatches and --gas-delay, allowed: at least one")
    config = dataclasses.replace(settings(options), total_timesteps=options.decisions)
    for own in costs:  # refuses those that are not allowed
        overrides = {f"reward_weights.{term}": -cost for term, cost in own.items()}
        overrides = {**config.overrides, **overrides}
        check_environment(dataclasses.replace(config, overrides=overrides))
    env, params = make_environment(config)
    config = config.for_episodes(episode_decisions(params))
    paid = {term: -np.asarray([own[term] for own in costs], np.float32) for term in COSTS}
    numbers = {f"reward_weights.{term}": each for term, each in paid.items()}
    weights, name = train_worlds(env, params, numbers, config), config.algorithm
    learned = {name: algorithm_of(config).policy(env, config, weights, options.stochastic)}
    episodes, seed = options.episodes, options.seed
    scores = play_worlds(env, params, numbers, learned, episodes, seed, own_weights=True)[name]
    rows = [
        {"policy": name, **cost, **describe(in_world(scores, index), COLUMNS, seed)}
        for index, cost in enumerate(costs)
    ]
    for name, score in evaluate_policies(env, params, rules(env), episodes, seed).items():
        rows.append({"policy": name, **describe(score, COLUMNS, seed)})
    decisions = config.num_updates * config.steps_per_update
    each = f"{decisions} decisions of each learner, {episodes} episodes, seed {seed}"
    print(f"{config.scenario}, {each}", table_of(rows, LABELS, COLUMNS), sep="\n")
    played = {"decisions": decisions, "episodes": episodes, "seed": seed}
    return {"study": "weights", "scenario": config.scenario, **played, "rows": rows}


def plot(path: Path, report: dict[str, Any]) -> None:
    """Draws the report of `run` as a PNG: depleted EVs over MEDs and over the speed of gas vehicles.

    A point is a learner, with its cost, or a rule.
    """
    figure = new_figure(11, 5)
    learned = [row for row in report["rows"] if "gas_delay" in row]
    series = [
        ("PPO, cost of a MED", [row for row in learned if not row["gas_delay"]], "-"),
        ("PPO, cost of a lost second", [row for row in learned if row["gas_delay"]], ":"),
        *((row["policy"], [row], "") for row in report["rows"] if "gas_delay" not in row),
    ]
    depleted, *prices, _ = COLUMNS
    panels = {}
    for axes, column in zip(figure.subplots(1, 2), prices, strict=True):
        for number, (label, rows, line) in enumerate(series):
            if rows:
                draw_rows(axes, rows, column.metric, depleted.metric, number, label=label, ls=line)
        for row in learned:
            # Costs of either kind stand on their own side: their points lie close together.
            side: dict[str, Any] = {"xytext": (7, -13)} if row["gas_delay"] else LEFT
            cost = row["gas_delay"] or row["dispatches"]
            point = row[column.metric], row[depleted.metric]
            axes.annotate(f"{cost:g}", point, textcoords="offset points", **side)
        axes.margins(0.1)
        panels[axes] = f"{column.axis}, 95 % CI", f"{depleted.axis}, 95 % CI"
    each = f"{report['decisions']} decisions of each learner, {report['episodes']} episodes"
    finish(figure, panels, f"{report['scenario']}: {each}", 3, path)
