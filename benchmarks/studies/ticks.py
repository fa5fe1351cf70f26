"""`python -m benchmarks.ticks`: whether the length of a tick affects results.

Rules play the same episodes at several ticks. Arrivals, drivers' noise and actions are drawn once per decision, so that
episodes are paired. Dense traffic forgets this pairing within a minute, so the comparison is of means.
"""

import argparse
from typing import Any

import jax
import numpy as np

import medjax
from benchmarks.command import a_number, episodes_parser, run_command
from benchmarks.studies.ablation.scores import Column
from benchmarks.studies.ablation.sweeps import rows_of, table_of
from medjax.episodes.scores import Scores, evaluate_policies
from medjax.errors import InputError
from medjax.policies.rules import BASELINES

RULES = ("forecast", "paced", "none")
TICKS_S = (0.125, 0.25, 0.5)
COLUMNS = (
    Column("return", "return", ""),
    Column("depleted_share", "depleted share", ""),
    Column("energy_delivered_kwh", "kWh delivered", ""),
    Column("gas_mean_speed", "others' speed, m/s", ""),
    Column("lane_changes", "lane changes", ""),
    Column("collisions", "collisions", ""),
)


def play(scenario: str, tick_s: float, episodes: int, seed: int) -> dict[str, Scores]:
    """Scores of the rules at this tick, with entry rounds as long as the preset's.

    Raises:
      InputError: a round is not a whole number of ticks.
    """
    config = medjax.SCENARIOS[scenario].config
    ticks = round(config.round_s / tick_s)
    if abs(ticks * tick_s - config.round_s) > 1e-6:
        raise InputError(
            f"--ticks {tick_s:g}: allowed parts of a round of entries of {config.round_s:g} s"
        )
    env, params = medjax.make(scenario, tick_s=tick_s, ticks_per_round=ticks)
    policies = {name: BASELINES[name](env) for name in RULES}
    return evaluate_policies(env, params, policies, episodes, seed)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints one row per rule and tick, and the difference from the first tick with its interval."""
    ticks, seed = options.ticks, options.seed
    played = [play(options.scenario, tick, options.episodes, seed) for tick in ticks]
    rows = []
    for name in RULES:
        score = jax.tree.map(lambda *each: np.stack(each), *(scores[name] for scores in played))
        rows += rows_of(name, score, ticks, seed, COLUMNS)
    print(f"{options.scenario}, {options.episodes} episodes, seed {seed}: length of a tick (s)")
    print(table_of(rows, ticks[0], COLUMNS))
    return {"scenario": options.scenario, "episodes": options.episodes, "rows": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("ticks", __doc__, episodes=128, seed=0)
    parser.add_argument(
        "--ticks",
        type=a_number("a tick from 0.01 to 1 s", lambda value: 0.01 <= value <= 1.0),
        nargs="+",
        default=list(TICKS_S),
        metavar="S",
        help=f"tick lengths, s (default: {' '.join(map(str, TICKS_S))})",
    )
    run_command(parser, measure, arguments)
