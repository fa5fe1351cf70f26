"""`python -m benchmarks.ticks`: whether the length of a tick affects results.

Rules play the same episodes at several ticks. Arrivals, drivers' noise and actions are drawn once per decision, so that
episodes are paired. Dense traffic forgets this pairing within a minute, so the comparison is of means.
"""

import argparse
from typing import Any

import medjax
from benchmarks.command import a_number, add_number, episodes_parser, run_command
from benchmarks.studies.base import Column, describe, rules, table_of
from medjax.episodes.scores import Scores, evaluate_policies
from medjax.errors import InputError

RULES = ("forecast", "paced", "none")
TICKS_S = (0.125, 0.25, 0.5)
LABELS = {"policy": "policy", "value": "value"}
COLUMNS = (
    Column("return", "return"),
    Column("depleted_share", "depleted share"),
    Column("energy_delivered_kwh", "kWh delivered"),
    Column("gas_mean_speed", "others' speed, m/s"),
    Column("lane_changes", "lane changes"),
    Column("collisions", "collisions"),
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
    return evaluate_policies(env, params, rules(env, RULES), episodes, seed)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints one row per rule and tick, and the difference from the first tick with its interval."""
    first, episodes, seed = options.ticks[0], options.episodes, options.seed
    played = {tick: play(options.scenario, tick, episodes, seed) for tick in options.ticks}
    rows = [
        {"policy": name, "value": tick} | describe(scores[name], COLUMNS, seed, played[first][name])
        for name in RULES
        for tick, scores in played.items()
    ]
    print(f"{options.scenario}, {episodes} episodes, seed {seed}: length of a tick (s)")
    print(table_of(rows, LABELS, COLUMNS, ("value", first)))
    return {"scenario": options.scenario, "episodes": episodes, "rows": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("ticks", __doc__, episodes=128, seed=0)
    kind = a_number("a tick from 0.01 to 1 s", lambda value: 0.01 <= value <= 1.0)
    add_number(parser, "--ticks", TICKS_S, "tick lengths, s", kind, nargs="+")
    run_command(parser, measure, arguments)
