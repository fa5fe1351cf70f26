"""`python -m benchmarks.validation`: compares traffic of medjax and SUMO on the same road with published ranges.

Demands on the road of `paper` range from free flow to overload, and one rises until traffic breaks down. The same
functions measure both simulators' trajectories. The table shows each figure with its 95 % interval over episodes, the
range in which it should lie, and the source of that range.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
from typing import Any

from benchmarks import command
from benchmarks.command import say, whole_number
from benchmarks.verification.validation import report
from benchmarks.verification.validation.demands import (
    DEMANDS,
    SLOTS,
    Demand,
    free_speed,
    mean_demand,
    world,
)
from benchmarks.verification.validation.measures import Findings, find, half_widths, summarise
from benchmarks.verification.validation.medjax_side import MODELS, observe
from benchmarks.verification.validation.plot import draw
from benchmarks.verification.validation.published import checks
from benchmarks.verification.validation.sumo_side import sumo

PACKAGES = {**dict.fromkeys(MODELS, "medjax"), "SUMO": "eclipse-sumo"}


def both_sides(demand: Demand, options: argparse.Namespace) -> dict[str, list[Findings]]:
    """Findings of each simulator's episodes under a demand. SUMO runs beside medjax, in processes of its own."""
    _, schedule = world(demand, options.minutes)

    def ours() -> dict[str, list[Findings]]:
        return {
            name: observe(*world(demand, options.minutes, model), options.episodes, options.seed)
            for name, model in MODELS.items()
        }

    if importlib.util.find_spec("sumo") is None:
        return ours()
    with sumo(schedule, options.episodes, options.seed) as rows:
        found, speed = ours(), free_speed(schedule)
        return {**found, "SUMO": [find(seen, speed) for seen in rows]}


def compare(options: argparse.Namespace) -> dict[str, Any]:
    """Measures everything and prints the tables."""
    found: dict[str, dict[str, list[Findings]]] = {}
    for name in options.demands:
        say(f"{name}: {options.episodes} episodes")
        found[name] = both_sides(DEMANDS[name], options)
    simulators = list(next(iter(found.values())))
    if "SUMO" not in simulators:
        say('SUMO: not installed, skipped (pip install -e ".[peers]")')
    figures = _each(found, summarise)
    for name, sides in figures.items():
        _, schedule = world(DEMANDS[name], options.minutes)
        for values in sides.values():
            values |= mean_demand(schedule)
        if sides["medjax"]["vehicles_max"] >= SLOTS:
            say(f"{name}: medjax's slots were all taken, so some traffic could not enter")
    against = checks(figures, _each(found, half_widths))
    for lines in (report.table_of_ranges(against, simulators), report.table_by_demand(figures)):
        print("\n".join([*lines, ""]))
    result = {
        "episodes": options.episodes,
        "minutes": options.minutes,
        "seed": options.seed,
        "simulators": {name: importlib.metadata.version(PACKAGES[name]) for name in simulators},
        **command.machine(),
        "figures": figures,
        "checks": against,
        "diagram": _each(found, report.diagram_points),
        "history": _each(found, report.history),
    }
    return dict(report.for_json(result))


def _each(found: dict[str, dict[str, list[Findings]]], of: Any) -> dict[str, dict[str, Any]]:
    """Applies `of` to the findings of each demand and simulator."""
    return {
        demand: {name: of(findings) for name, findings in sides.items()}
        for demand, sides in found.items()
    }


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = command.benchmark_parser("validation", __doc__)
    option, names = parser.add_argument, list(DEMANDS)
    option("--episodes", type=whole_number(most=100), default=5, help="episodes per demand")
    minutes = "minutes to measure per episode, after five that fill the road; the rising demand takes twice as many"
    option("--minutes", type=whole_number(most=10_000), default=20, help=minutes)
    option("--seed", type=command.a_seed, default=0, help="seed of the episodes")
    some = f"some of {', '.join(names)} (default: all)"
    option("--demands", nargs="+", choices=names, default=names, metavar="NAME", help=some)
    command.add_plot(parser, "the fundamental diagram and merging")
    command.run_command(parser, compare, arguments, draw)
