"""`python -m benchmarks.generalization`: dispatchers at demands that they were not made for.

Trained runs and rules play the same episodes of `paper`, at several multiples of its demand, and of `realistic`. The
runs play twice, by their most probable actions and sampled, whatever presets and demands they were trained on.
"""

import argparse
import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

import medjax
from benchmarks.command import a_path, add_plot, episodes_parser, run_command
from benchmarks.studies.base import RULES, estimate, format_estimate, rules
from benchmarks.studies.drawing import draw_rows, finish
from medjax.episodes.scores import Evaluation, Scores
from medjax.errors import InputError
from medjax.numerics.compilation import enable_compilation_cache
from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES
from medjax.wrappers import scale_demand
from train.evaluation.summary import learned_names, summarize
from train.evaluation.tables import SAMPLED, format_rows
from train.reporting.figures import new_figure
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir

MAIN, OTHER = "paper", "realistic"
FACTORS = (0.5, 0.75, 1.0, 1.25, 1.5)  # of MAIN's demand
AT_FACTORS = {f"{MAIN} x {factor:g}": factor for factor in FACTORS}
REFERENCE, NO_ACTION = "budgeted", "none"
# Colours of trained runs, from Okabe and Ito (2008); markers tell them from rules of the same colour.
RUN_COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#000000")
# At 1.5 times the demand the preset's slots would fill up, and arrivals would wait off the road.
SIZES: dict[str, Any] = {"num_gas": 288}


def load_runs(paths: Sequence[Path], scenario: str) -> dict[str, Policy]:
    """The trained policies of all runs, ready to play a preset, most probable and sampled.

    Each seed's policy is named after the run's directory. The name of one that samples ends in `SAMPLED`.

    Raises:
        InputError: a path is no run, its network does not fit the preset, or its name is taken.
    """
    found: dict[str, Policy] = {}
    for path in paths:
        config = RunDir(path).load_config()
        config = dataclasses.replace(config, scenario=scenario, overrides=SIZES, num_devices=0)
        env, _, policies = load_policies(path, config)
        own = {
            name.replace(config.algorithm, path.name, 1) + end: _with_own_observation(
                env, policies[name + end]
            )
            for name in learned_names(policies)
            for end in ("", SAMPLED)
        }
        if own.keys() & {*found, *BASELINES}:
            raise InputError(f"run {path} has a name that is taken, allowed: names of their own")
        found |= own
    return found


def _with_own_observation(env: medjax.ChargingEnv, policy: Policy) -> Policy:
    """Makes `policy` observe through `env`, whatever environment it plays in."""

    def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """See `Policy.act`."""
        return policy.act(weights, key, env.get_obs(state, params), state, params)

    return policy.replace(act=act)


def play(
    scenario: str,
    factors: Mapping[str, float],
    runs: Mapping[str, Policy],
    episodes: int,
    seed: int,
) -> dict[str, Any]:
    """Plays the same episodes with all policies at each demand, in one compiled program.

    Args:
        scenario: preset.
        factors: multiples of its demand, by name of the world.
        runs: trained policies by name, to which the rules are added.
        episodes, seed: as in `medjax.episodes.scores`.

    Returns:
        What `--json` writes for each world.
    """
    env, params = medjax.make(scenario, **SIZES)
    policies = {**runs, **rules(env)}
    evaluation = Evaluation(env, params, policies, episodes)
    return {
        world: summary(evaluation.play(policies, seed, scale_demand(params, factor)), world, seed)
        for world, factor in tqdm(factors.items(), scenario, disable=None, leave=False)
    }


def summary(scores: Mapping[str, Scores], world: str, seed: int) -> dict[str, Any]:
    """What `--json` writes for one world.

    Returns:
        `policies` as in `train.evaluation.summary.summarize`, and `minus_budgeted` and `minus_none`, the mean and
        interval of each other policy's return minus that rule's on the same episodes.
    """
    found = {"policies": summarize(scores, world, (), seed)["policies"]}
    for rule in (REFERENCE, NO_ACTION):
        base = scores[rule]["return"]
        found[f"minus_{rule}"] = {
            name: estimate(score["return"] - base, seed)
            for name, score in scores.items()
            if name != rule
        }
    return found


def tables(worlds: Mapping[str, Any], runs: Sequence[str]) -> str:
    """Tables of returns, depleted shares, and gains of the runs on REFERENCE, with a column for each world."""

    def mean_return(entry: Any) -> str:
        return format_estimate({"mean": entry["return_mean"], "ci95": entry["return_ci95"]})

    def share(entry: Any) -> str:
        return f"{entry['depleted_share']:.3f}"

    gains = f"minus {REFERENCE}, 95 % CI", f"minus_{REFERENCE}", runs, format_estimate
    parts = []
    for head, kind, names, cell in (
        ("return, 95 % CI", "policies", [*runs, *RULES], mean_return),
        ("depleted share", "policies", [*runs, *RULES], share),
        gains,
    ):
        rows = [[name, *(cell(world[kind][name]) for world in worlds.values())] for name in names]
        parts.append(format_rows([[head, *worlds], *rows]))
    return "\n\n".join(parts)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the tables.

    Raises:
        InputError: as in `load_runs`.
    """
    enable_compilation_cache()
    paths = [Path(os.path.abspath(given)) for given in options.run_dir]
    runs, elsewhere = load_runs(paths, MAIN), load_runs(paths, OTHER)
    which = options.episodes, options.seed
    worlds = play(MAIN, AT_FACTORS, runs, *which) | play(OTHER, {OTHER: 1.0}, elsewhere, *which)
    print(f"{options.episodes} episodes, seed {options.seed}, the same for every policy\n")
    print(tables(worlds, list(runs)))
    return {"episodes": options.episodes, "seed": options.seed, "worlds": worlds}


def plot(path: Path, report: dict[str, Any]) -> None:
    """Draws the report of `measure` as a PNG: each policy's gain on no action by demand, with rules dashed.

    Policies that sample are left out: their lines would hide those of the same networks.
    """
    demand = medjax.make(MAIN)[1].demand
    vehicles_per_h = float(demand.mainline_per_h + demand.ramp_per_h.sum())
    worlds = {factor: report["worlds"][name]["minus_none"] for name, factor in AT_FACTORS.items()}
    figure = new_figure(8, 5)
    axes = figure.add_subplot()
    names = worlds[1.0]
    sampled = {name + SAMPLED for name in names}
    for number, name in enumerate(each for each in names if each not in sampled):
        rows = [
            {"policy": name, "factor": factor, "gain": gains[name]["mean"]}
            | {"gain_ci95": gains[name]["ci95"]}
            for factor, gains in worlds.items()
        ]
        of_run = {"color": RUN_COLOURS[number % len(RUN_COLOURS)]}
        style = {"ls": "--"} if name in BASELINES else of_run
        draw_rows(axes, rows, "factor", "gain", number, label=name, **style)
    axes.axhline(0.0, color="0.5", lw=1)
    axes.set_xticks([*worlds])
    x = f"demand, multiples of {vehicles_per_h:.0f} vehicles/h"
    y = "return of an episode minus that of no action, 95 % CI"
    finish(figure, {axes: (x, y)}, "Other demands than the preset's", 5, path)


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("generalization", __doc__, episodes=256, seed=0, scenario=False)
    a_run = "directories that train.ppo wrote"
    parser.add_argument(
        "--run-dir", type=a_path, nargs="+", required=True, metavar="DIR", help=a_run
    )
    add_plot(parser, "the gains")
    run_command(parser, measure, arguments, plot)
