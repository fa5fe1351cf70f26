"""`python -m benchmarks.worth`: when do MEDs pay, and what is a good dispatcher worth there?

A map of break-even: at every point, a combination of numbers of the world and of prices, dispatchers play the same
episodes as `none` and `slow`, which send no MED. The gain is that of the best dispatcher on the better of these two,
in EUR an hour. Who is best is chosen on the other half of the episodes. Prices only weigh what happened, so they cost
no simulation. `--keep FILE` keeps what was played: the same command of the same version goes on from there. Changes
that are not committed are not told apart.
"""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from tqdm import tqdm

from benchmarks.command import add_plot, episodes_parser, output_file, run_command
from benchmarks.studies.base import add_run_dir, dispatcher_settings, load
from benchmarks.studies.worth.axes import (
    PRICE,
    Axis,
    Point,
    check_prices,
    points,
    read_axes,
    world_at,
)
from benchmarks.studies.worth.drawing import Panel, draw, panels_of
from benchmarks.studies.worth.played import Kept, Player, fingerprint
from benchmarks.studies.worth.verdicts import Verdict, judge
from medjax.commandline import add_set_option
from medjax.errors import InputError
from medjax.numerics.compilation import enable_compilation_cache
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from medjax.scenarios import prepare
from medjax.world.presets import SCENARIOS
from train.evaluation.tables import START, format_rows
from train.runs.versions import versions
from train.settings import TrainConfig

CONTROLS = ("none", "slow")
RULES = ("greedy", "budgeted")


def dispatchers_of(policies: dict[str, Policy]) -> dict[str, Policy]:
    """RULES and the learners of a run."""
    others = {START, *BASELINES} - {*RULES}
    return {name: policy for name, policy in policies.items() if name not in others}


def conclusion(axes: Sequence[Axis], cells: Sequence[tuple[Point, Verdict]]) -> str:
    """What the map says, in two sentences."""
    pays = [verdict.pays for _, verdict in cells]
    name, shares = axes[0].name, []
    for value in axes[0].values:
        here = [each for (point, _), each in zip(cells, pays, strict=True) if point[name] == value]
        shares.append(f"{here.count('yes')} of {len(here)} at {axes[0].label(value)}")
    return (
        f"MEDs surely pay in {pays.count('yes')} of {len(pays)} cases and surely do not in {pays.count('no')}; "
        f"{pays.count('open')} are open. They pay in {', '.join(shares)}."
    )


def checked_axes(options: argparse.Namespace, config: TrainConfig) -> list[Axis]:
    """The axes of the map, every point of which is a valid world; compiles nothing.

    Raises:
      InputError: an axis or a value that is not allowed, or a preset whose reward is not in money.
    """
    in_money = [name for name, preset in SCENARIOS.items() if preset.reward == "money"]
    if config.scenario not in in_money:
        what = f"--scenario {config.scenario}: its reward is not in money"
        raise InputError(f"{what}, allowed one of {', '.join(in_money)}")
    axes = read_axes(options.vary, config.scenario)
    overrides: dict[str, Any] = dict(config.overrides)
    env, params, _ = prepare(config.scenario, **overrides)
    check_prices(axes, params)
    for point in points(axes):
        world_at(env.config, params, point)
    return axes


def play(
    axes: Sequence[Axis],
    players: Sequence[Player],
    kept: Kept,
    prices: Mapping[str, Any],
    seed: int,
) -> list[tuple[Point, Verdict]]:
    """Plays every point of the map; `prices` are the preset's, by term."""
    player, cells = players[0], []
    hours = hours_of(player.env, player.params)
    for point in tqdm([*points(axes)], "cases", disable=None, leave=False):
        scores = {name: score for each in players for name, score in each.play(point, kept).items()}
        given = {name.removeprefix(PRICE): point[name] for name in point if name.startswith(PRICE)}
        terms = {term: price / float(prices[term]) for term, price in given.items()}
        cells.append((point, judge(scores, CONTROLS, terms, hours, seed)))
    return cells


def hours_of(env: Any, params: Any) -> float:
    """Length of an episode, h."""
    return float(params.episode_decisions) * float(env.config.decision_s) / 3600.0


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Plays the map, prints it, and returns the report."""
    config = dispatcher_settings(options)
    results = [path.resolve() for path in (options.json, options.plot) if path]
    if options.keep and options.keep.resolve() in results:
        raise InputError(
            f"--keep {options.keep} is also a file of results, allowed: one of its own"
        )
    axes = checked_axes(options, config)
    env, params, policies = load(options, config)
    dispatchers = dispatchers_of(policies)
    about = {"scenario": config.scenario, "episodes": options.episodes, "seed": options.seed}
    about |= {"overrides": config.overrides, "policies": [*dispatchers, *CONTROLS]}
    about |= {"numbers": fingerprint(params, dispatchers), "versions": versions()}
    controls = {name: BASELINES[name](env) for name in CONTROLS}
    simulated = [axis for axis in axes if not axis.is_price]
    of_controls = [axis for axis in simulated if not axis.is_of_meds]
    players = (
        Player(env, params, dispatchers, simulated, options),
        Player(env, params, controls, of_controls, options),
    )
    kept = Kept(options.keep, about)
    cells = play(axes, players, kept, params.reward_weights, options.seed)
    played = sum(player.worlds for player in players)
    report = about | {
        "axes": {axis.name: axis.values for axis in axes},
        "hours": hours_of(env, params),
        "conclusion": conclusion(axes, cells),
        "cells": [
            {"at": point} | dataclasses.asdict(verdict) | {"pays": verdict.pays}
            for point, verdict in cells
        ],
    }
    print(
        f"{config.scenario}: {len(cells)} cases; {options.episodes} episodes of seed {options.seed} in each of "
        f"{played} simulations",
        "EUR an hour that the best dispatcher gains on the better of none and slow; *: the 95 % interval leaves out 0",
        *map(text_of, panels_of(report)),
        f"\n{report['conclusion']}",
        sep="\n",
    )
    return report


def text_of(panel: Panel) -> str:
    """A panel as a table."""
    heading = f"{panel.y.heading} \\ {panel.x.heading}"
    table = [[heading, *map(panel.x.number, panel.x.values)]]
    for value, gains, is_sure in zip(panel.y.values, panel.gain, panel.is_sure, strict=True):
        cells = (
            f"{gain:+.0f}{'*' if sure else ' '}" for gain, sure in zip(gains, is_sure, strict=True)
        )
        table.append([panel.y.number(value), *cells])
    return f"\n{panel.title}\n{format_rows(table)}"


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = episodes_parser("worth", __doc__, episodes=64, seed=0)
    add_run_dir(parser, "also play the learners of this run")
    parser.set_defaults(scenario="freight")
    text = "a number and its values, e.g. slot_power_w=20e3,50e3; repeatable; default: the preset's map"
    parser.add_argument("--vary", action="append", default=[], metavar="NAME=A,B", help=text)
    text = "keep what is played in this file, and go on from what it holds"
    parser.add_argument("--keep", type=output_file, metavar="FILE", help=text)
    add_set_option(parser, "set another parameter of the environment; repeatable")
    add_plot(parser, "the map")
    enable_compilation_cache()
    run_command(parser, measure, arguments, lambda path, report: draw(path, panels_of(report)))
