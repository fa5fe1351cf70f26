"""`python -m benchmarks.road [FILE]`: travel times on a motorway, in SUMO and in medjax.

FILE is a network of SUMO (net.xml), by default the Autobahn A 10 that comes with SUMO. SUMO drives on the network
itself, medjax on the road that `medjax.read_sumo_net` makes of it. Both have the drivers, lorries and demand of
`corridor` without EVs, at some factors of that demand. A row is a way along the motorway, from its beginning or a ramp
to its end or an exit.

Times are of vehicles that enter within the measured minutes. Five minutes before these fill the road. Vehicles have
fifteen minutes after these to leave it. On a way to an exit, the time ends where the last edge before the exit begins,
which is the deceleration lane's.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import medjax
from benchmarks import command
from benchmarks.command import whole_number
from benchmarks.verification.own_road.sides import medjax_times, sumo_times
from benchmarks.verification.own_road.ways import ways_of, world
from benchmarks.verification.validation.measures import half_width, percentile
from benchmarks.verification.validation.medjax_side import MODELS
from benchmarks.verification.validation.report import for_json, shown
from medjax.errors import InputError
from medjax.world.sumo_net import motorway_of, read_network

SIMULATORS = (*MODELS, "SUMO")


def compare(options: argparse.Namespace) -> dict[str, Any]:
    """Measures everything and prints the table."""
    file = options.file or autobahn()
    network = read_network(file)
    chain = motorway_of(file, network, options.edges)
    sumo_home()  # before minutes are played in medjax
    road = medjax.read_sumo_net(file, chain)
    seeds = range(1 + options.seed * options.episodes, 1 + (options.seed + 1) * options.episodes)
    rows = []
    for factor in options.factors:
        command.say(f"{factor:g} of the demand: {options.episodes} episodes")
        sides = {}
        for name, following in MODELS.items():
            env, params = world(road, factor, following)
            ways = ways_of(network, chain, params)
            sides[name] = medjax_times(env, params, ways, options.minutes, seeds)
        world_of = env.config, params
        sides["SUMO"] = sumo_times(file, world_of, ways, options.minutes, seeds)
        for number, way in enumerate(ways):
            figures = {name: figures_of(times[number]) for name, times in sides.items()}
            rows.append({"factor": factor, "begin_m": way.begin_m, "end_m": way.end_m} | figures)
    print("\n".join(_table(rows)))
    return dict(for_json({"edges": chain, "rows": rows, **command.machine()}))


def sumo_home() -> Path:
    """The directory of SUMO; raises InputError where it is not installed."""
    if importlib.util.find_spec("sumo") is None:
        raise InputError('SUMO is not installed: allowed pip install -e ".[peers]"')
    import sumo

    return Path(sumo.SUMO_HOME)


def autobahn() -> Path:
    """The network of the A 10 at Koenigs Wusterhausen that comes with SUMO."""
    return sumo_home() / "tools/game/A10KW/osm.net.xml"


def figures_of(times: Sequence[np.ndarray]) -> dict[str, float]:
    """Vehicles an episode, their mean time with its 95 % half-width over episodes, and the 95th percentile, s."""
    means, every = [float(np.mean(each)) for each in times if len(each)], np.concatenate(times)
    return {
        "vehicles": len(every) / len(times),
        "mean_s": float(np.mean(means)) if means else math.nan,
        "half_width_s": half_width(means),
        "p95_s": percentile(every, 95.0),
    }


def _table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of a Markdown table with a row for each demand and way."""
    titles = [f"{name}, s | 95th percentile, s | vehicles" for name in SIMULATORS]
    lines = [f"| demand | way, m | {' | '.join(titles)} |", "|---:|---|" + "---:|" * 9]
    for row in rows:
        cells = [f"{row['factor']:g}", f"{row['begin_m']:,.0f} to {row['end_m']:,.0f}"]
        for of in (row[name] for name in SIMULATORS):
            cells.append(f"{shown(of['mean_s'], 1)} ± {shown(of['half_width_s'], 1)}")
            cells += [shown(of["p95_s"], 0), shown(of["vehicles"], 0)]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = command.benchmark_parser("road", __doc__)
    add = parser.add_argument
    network = "network of SUMO (net.xml; default: the A 10 that comes with SUMO)"
    add("file", type=command.a_path, nargs="?", metavar="FILE", help=network)
    edges = "the motorway's edges in driving order (default: the longest motorway)"
    add("--edges", nargs="+", metavar="EDGE", help=edges)
    command.add_number(parser, "--episodes", 5, "episodes per demand", whole_number(2, 100))
    minutes = "minutes in which the measured vehicles enter"
    command.add_number(parser, "--minutes", 20, minutes, whole_number(1, 240))
    command.add_number(parser, "--seed", 0, "seed of the episodes", whole_number(0, 10**6))
    factors = "factors of the demand: 1,200 vehicles an hour in each lane, and 360 from each ramp"
    a_factor = command.a_number("a number from 0 to 5", lambda factor: 0.0 <= factor <= 5.0)
    command.add_number(parser, "--factors", [0.5, 1.0, 1.4], factors, a_factor, "+")
    command.run_command(parser, compare, arguments)
