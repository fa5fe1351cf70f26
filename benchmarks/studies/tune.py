"""`python -m benchmarks.tune`: the best settings of the rules that have any.

What PPO has to beat should be as good as its kind can be. `medjax.policies.paced` is played with every interval and
ramp, `medjax.policies.forecast` with every window and threshold, all on the same episodes, whose seed no evaluation
uses by default.
"""

import argparse
from typing import Any

import medjax
from benchmarks.command import episodes_parser, run_command
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import forecast, paced
from train.evaluation.statistics import bootstrap_ci95

RULES = {"paced": paced, "forecast": forecast}
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


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints a line for each setting, and the best one of each rule."""
    env, params = medjax.make(options.scenario)
    report = {}
    for rule in options.rules:
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
        report[rule] = {"rows": rows, "best": best}
    return report


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("tune", __doc__, episodes=256, seed=31)
    parser.add_argument("--rules", nargs="+", default=list(RULES), choices=list(RULES))
    run_command(parser, measure, arguments)
