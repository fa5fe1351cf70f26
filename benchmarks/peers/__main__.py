"""`python -m benchmarks.peers`: compares the speed of medjax with other simulators on the same road.

The figure is active vehicle updates per second: vehicles on the road, summed over ticks, per wall time on all cores.
Rounds alternate between the simulators, so that a slowdown of the machine affects all alike; medians are compared.
"""

import argparse
import dataclasses
import importlib.metadata
import platform
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import medjax
from benchmarks.command import benchmark_parser, machine, positive, run_command, say
from benchmarks.peers import Peer, Rate, World
from benchmarks.peers.highway import HighwayEnv
from benchmarks.peers.sumo import Sumo
from benchmarks.speed.workload import measure
from medjax.commandline import OneLineParser
from medjax.numerics.devices import cpu_cores

PEERS: tuple[type[Any], ...] = (Sumo, HighwayEnv)  # each is built with a World
SCENARIO = "paper"
COUNTED_ROADS = 64  # enough to know the mean number of vehicles to 1 %


class Medjax(Peer):
    """The complete default step under random actions, in one process on all cores."""

    name = "medjax"
    package = "medjax"
    differences = (
        "It moves many roads in one process on all cores, in single precision; compilation is left out.",
        "It does the complete default step: dispatch, entries, booking, docking, coils, batteries, "
        "driver noise, observation, reward, metrics and auto-reset, under random actions.",
    )

    def __init__(self, num_envs: int, decisions: int) -> None:
        self.num_envs = num_envs
        self.decisions = decisions

    def measure(self) -> Rate:
        """Times `decisions` decisions on all roads, after as many for warm-up."""
        result = measure(self.num_envs, steps=self.decisions, repeats=1, scenario=SCENARIO)
        return Rate(result.active_vehicle_updates_per_s, result.mean_active_vehicles)


@dataclasses.dataclass(frozen=True)
class Result:
    """A simulator's row of the table."""

    version: str
    active_vehicle_updates_per_s: float  # median over rounds
    mean_active_vehicles: float  # median over rounds
    medjax_ratio: float  # medjax's figure divided by this one
    rounds: list[float]  # active vehicle updates per second, by round
    differences: tuple[str, ...]


def installed_version(package: str) -> str | None:
    """The version of a distribution, or None if it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def alternate(simulators: Sequence[Peer], rounds: int) -> dict[str, list[Rate]]:
    """Measures every simulator once per round, in the given order."""
    rates: dict[str, list[Rate]] = {simulator.name: [] for simulator in simulators}
    for number in range(1, rounds + 1):
        for simulator in simulators:
            rate = simulator.measure()
            rates[simulator.name].append(rate)
            say(
                f"round {number}/{rounds}: {simulator.name} "
                f"{rate.active_vehicle_updates_per_s:,.0f} active vehicle updates/s"
            )
    return rates


def summarise(simulators: Sequence[Peer], rates: dict[str, list[Rate]]) -> dict[str, Result]:
    """Medians over rounds, and the ratio of the first simulator's, medjax's, to each."""
    medians = {
        name: statistics.median(rate.active_vehicle_updates_per_s for rate in measured)
        for name, measured in rates.items()
    }
    return {
        simulator.name: Result(
            version=installed_version(simulator.package) or "unknown",
            active_vehicle_updates_per_s=medians[simulator.name],
            mean_active_vehicles=statistics.median(
                rate.mean_active_vehicles for rate in rates[simulator.name]
            ),
            medjax_ratio=medians[simulators[0].name] / medians[simulator.name],
            rounds=[rate.active_vehicle_updates_per_s for rate in rates[simulator.name]],
            differences=simulator.differences,
        )
        for simulator in simulators
    }


def compare(options: argparse.Namespace) -> dict[str, Any]:
    """Measures everything; prints the table and the differences."""
    present, skipped = [], []
    for peer in PEERS:
        if installed_version(peer.package) is None:
            skipped.append(peer.name)
            say(f'{peer.name}: not installed, skipped (pip install -e ".[peers]")')
        else:
            present.append(peer)
    env, params = medjax.make(SCENARIO)
    # As with SUMO, one episode is warm-up and another is timed. A part of an episode would not do, since MEDs
    # enter over its course.
    decisions = int(params.episode_decisions)
    cores = cpu_cores()
    say(f"counting vehicles in {COUNTED_ROADS} roads of medjax")
    counted = Medjax(COUNTED_ROADS, decisions).measure()
    num_vehicles = round(counted.mean_active_vehicles)
    with tempfile.TemporaryDirectory() as folder:
        workload = World(env.config, params, num_vehicles, cores, Path(folder))
        simulators = [Medjax(options.num_envs, decisions), *(peer(workload) for peer in present)]
        results = summarise(simulators, alternate(simulators, options.rounds))
    comparison = {
        "scenario": SCENARIO,
        "unit": "active vehicle updates per second",
        "rounds": options.rounds,
        "num_envs": options.num_envs,
        "cores": cores,
        "platform": platform.platform(),
        "python_version": platform.python_version(),
        **machine(),
        "simulators": {name: dataclasses.asdict(result) for name, result in results.items()},
        "skipped": skipped,
    }
    print(report(comparison))
    return comparison


def report(comparison: dict[str, Any]) -> str:
    """Formats the table and the differences."""
    lines = [
        f"Active vehicle updates a second, medians of {comparison['rounds']} alternating rounds; "
        f"{comparison['cores']} cores, medjax on {comparison['backend']} ({comparison['device']})",
        "",
        f"{'':14}{'version':>10}{'vehicles a road':>18}{'updates/s':>14}{'medjax / it':>14}",
    ]
    for name, result in comparison["simulators"].items():
        lines.append(
            f"{name:14}{result['version']:>10}{result['mean_active_vehicles']:18.0f}"
            f"{result['active_vehicle_updates_per_s']:14,.0f}{result['medjax_ratio']:14,.1f}"
        )
    for name in comparison["skipped"]:
        lines.append(f"{name:14}not installed, skipped")
    lines += ["", "What differs:"]
    for name, result in comparison["simulators"].items():
        lines += [name, *(f"  - {difference}" for difference in result["differences"])]
    return "\n".join(lines)


def build_parser() -> OneLineParser:
    """The command line."""
    parser = benchmark_parser("peers", __doc__)
    parser.add_argument(
        "--rounds", type=positive, default=3, metavar="N", help="timed rounds (default: 3)"
    )
    parser.add_argument(
        "--num-envs",
        type=positive,
        default=1024,
        metavar="N",
        help="roads that medjax simulates at once (default: 1024)",
    )
    return parser


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    run_command(build_parser(), compare, arguments)


if __name__ == "__main__":
    main()
