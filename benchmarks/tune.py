"""`python -m benchmarks.tune`: the best spacing and ramp of the rule that sends MEDs at a fixed pace.

What PPO has to beat should be as good as its kind can be. The rule `medjax.policies.paced` is played with every
interval and ramp on the same episodes, whose seed no evaluation uses by default.
"""

from __future__ import annotations

import json

import medjax
from benchmarks.arguments import episodes_parser, positive
from medjax.policies import paced
from medjax.wrappers import prepare_cpu
from train.bootstrap import bootstrap_ci95
from train.cli import OneLineParser
from train.evaluation import baseline, evaluate_policies

INTERVALS_S = (20, 24, 26, 28, 30, 32, 34, 36, 40)


def build_parser() -> OneLineParser:
    """The command line."""
    parser = episodes_parser("tune", __doc__, episodes=256, seed=31)
    parser.add_argument("--ramps", type=positive, nargs="+", default=[1, 2], metavar="R")
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Prints a line for each interval and ramp, the best one last."""
    options = build_parser().parse_args(arguments)
    prepare_cpu()
    env, params = medjax.make(options.scenario)
    pairs = {
        f"ramp {ramp}, {interval} s": (ramp, interval)
        for ramp in options.ramps
        for interval in INTERVALS_S
    }
    policies = {
        name: baseline(paced(env, interval, ramp)) for name, (ramp, interval) in pairs.items()
    }
    scores = evaluate_policies(env, params, policies, options.episodes, options.seed, batch=32)
    rows = []
    for name, score in scores.items():
        low, high = bootstrap_ci95(score["return"], options.seed)
        ramp, interval = pairs[name]
        row = {"ramp": ramp, "interval_s": interval, "return_mean": float(score["return"].mean())}
        rows.append(row | {"return_ci95": [low, high]})
        print(f"{name:<14} {row['return_mean']:8.1f} [{low:.1f}, {high:.1f}]", flush=True)
    best = max(rows, key=lambda row: row["return_mean"])
    print(f"best: ramp {best['ramp']}, every {best['interval_s']} s")
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "best": best}, indent=2))


if __name__ == "__main__":
    main()
