"""`python -m benchmarks.tune`: finds the best settings of the rules that have any.

The rules that PPO has to beat should be as good as they can be. `medjax.policies.paced` is played with every interval
and ramp, `medjax.policies.forecast` with every window and threshold. All play the same episodes, whose seed no
evaluation uses by default. `medjax.policies.budgeted` has too many numbers for a grid. It starts as `forecast` and
climbs the surface of its returns (`benchmarks.studies.response`), on new episodes in every round. The last line
compares it with `forecast` on the episodes of the grids.
"""

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

import medjax
from benchmarks.command import episodes_parser, positive, run_command, whole_number
from benchmarks.studies.response import GROUP, Responses, directions, fit, step_to_top
from medjax.commandline import add_set_option, parse_overrides
from medjax.env.contract import Environment
from medjax.episodes.scores import evaluate_policies
from medjax.policies.policy import Policy
from medjax.policies.rules import Budget, budgeted, forecast, paced
from train.evaluation.statistics import bootstrap_ci95

RULES: dict[str, Callable[..., Policy]] = {
    "paced": paced,
    "forecast": forecast,
    "budgeted": budgeted,
}
GRID: dict[str, list[dict[str, Any]]] = {
    "paced": [
        {"ramp": ramp, "interval_s": interval}
        for ramp in (1, 2)
        for interval in (24, 28, 30, 32, 34, 36, 38, 40)
    ],
    "forecast": [
        {"window_s": window, "enough": enough}
        for window in (45, 60, 75)
        for enough in (4.0, 4.5, 5.0, 5.5, 6.0, 6.5)
    ],
}


CLIMB_SEED = 1_000_000  # of the first round's episodes; each later round adds 1
LEAST_GROUPS = 8  # enough to fit the 54 terms of a quadratic in nine numbers

# The numbers that make `budgeted` act as `forecast`, and the spread of a round's variants.
AS_FORECAST = Budget(pack=0.0, coming=1.0, free=-1.0, ahead=0.0, time_left=0.0, ramp=(-5.0,) * 4)
SPREAD = Budget(pack=1.5, coming=0.15, free=0.15, ahead=4.0, time_left=1.0, ramp=(0.8,) * 4)


def play_grid(env: Environment, params: Any, rule: str, options: argparse.Namespace) -> Any:
    """Plays every setting of a grid; prints a line for each, and the best one."""
    named = {", ".join(f"{k} {v:g}" for k, v in row.items()): row for row in GRID[rule]}
    policies = {name: RULES[rule](env, **row) for name, row in named.items()}
    scores = evaluate_policies(env, params, policies, options.episodes, options.seed, batch=32)
    rows = []
    for name, score in scores.items():
        low, high = bootstrap_ci95(score["return"], options.seed)
        mean = float(score["return"].mean())
        rows.append(named[name] | {"return_mean": mean, "return_ci95": [low, high]})
        print(f"{rule}: {name:<26} {mean:8.1f} [{low:.1f}, {high:.1f}]", flush=True)
    best = max(rows, key=lambda row: row["return_mean"])
    print(f"best {rule}: " + ", ".join(f"{name} {best[name]:g}" for name in GRID[rule][0]))
    return {"rows": rows, "best": best}


def climb(env: Environment, params: Any, options: argparse.Namespace) -> Any:
    """Tunes `budgeted`; prints its numbers after every round and the gain on `forecast`."""
    responses = Responses(env, params, budgeted(env), GROUP * options.groups)
    numbers, spread = responses.numbers_of(AS_FORECAST), responses.numbers_of(SPREAD)
    rng, rounds = np.random.default_rng(options.seed), []
    for number in range(options.rounds):
        steps = directions(rng, options.groups, len(numbers))
        returns = responses.of(numbers + spread * steps, CLIMB_SEED + number)
        slope, curvature, error = fit(steps, returns)
        numbers = numbers + spread * step_to_top(slope, curvature)
        mean = float(returns.mean())
        found = {"numbers": numbers, "slope": slope, "slope_error": error}
        rounds.append({"return_mean": mean} | {name: each.tolist() for name, each in found.items()})
        print(f"budgeted: round {number + 1:2}, {mean:8.1f}, to {_shown(numbers)}", flush=True)
    best = budgeted(env, responses.policy_weights(numbers))
    rules = {"budgeted": best, "forecast": forecast(env)}
    scores = evaluate_policies(env, params, rules, options.episodes, options.seed)
    gain = scores["budgeted"]["return"] - scores["forecast"]["return"]
    mean, (low, high) = float(gain.mean()), bootstrap_ci95(gain, options.seed)
    print(f"best budgeted: {_shown(numbers)}")
    means = {
        name: float(np.mean(scores["budgeted"][name])) for name in ("return", "meds_dispatched")
    }
    print(
        f"it returns {means['return']:.1f}, sends {means['meds_dispatched']:.2f} MEDs, "
        f"gains on forecast {mean:.1f} [{low:.1f}, {high:.1f}]"
    )
    return {"rounds": rounds, "gain_mean": mean, "gain_ci95": [low, high], "means": means}


def _shown(numbers: np.ndarray) -> str:
    """The numbers of a `Budget` with their names, in the order of its leaves."""
    names = [*(name for name in Budget.__dataclass_fields__ if name != "ramp")]
    names += [f"ramp {number}" for number in range(1, len(numbers) - len(names) + 1)]
    return ", ".join(f"{name} {value:.2f}" for name, value in zip(names, numbers, strict=True))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Tunes each rule and prints the results."""
    env, params = medjax.make(options.scenario, **parse_overrides(options.overrides))
    return {
        rule: play_grid(env, params, rule, options) if rule in GRID else climb(env, params, options)
        for rule in options.rules
    }


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("tune", __doc__, episodes=256, seed=31)
    parser.add_argument("--rules", nargs="+", default=list(RULES), choices=list(RULES))
    add_set_option(parser, "set a parameter of the environment; repeatable")
    rounds = "rounds of hill climbing (default: %(default)s)"
    parser.add_argument("--rounds", type=positive, default=10, help=rounds)
    groups = f"episodes per round of hill climbing, each for {GROUP} rules (default: %(default)s)"
    parser.add_argument("--groups", type=whole_number(LEAST_GROUPS), default=96, help=groups)
    run_command(parser, measure, arguments)
