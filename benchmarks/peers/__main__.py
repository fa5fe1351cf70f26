"""`python -m benchmarks.peers`: compares the speed of medjax with other simulators on the same road.

The figure is active vehicle updates per second: vehicles on the road, summed over ticks, per wall time on all cores.
Rounds alternate between the simulators, so that a slowdown of the machine affects all alike; medians are compared.
"""

import argparse
import platform
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import medjax
from benchmarks.command import add_number, benchmark_parser, machine, run_command, say
from benchmarks.peers import Peer, Rate, World, installed_version
from benchmarks.peers.highjax import INSTALL, OWN_VEHICLES, HighJax, ask
from benchmarks.peers.highway import HighwayEnv
from benchmarks.peers.sumo import Sumo
from benchmarks.speed.workload import measure
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


def summarise(simulators: Sequence[Peer], rates: dict[str, list[Rate]]) -> dict[str, Any]:
    """Medians over rounds, and the ratio of the first simulator's, medjax's, to each, by name."""
    results: dict[str, Any] = {}
    for simulator in simulators:
        rounds = [rate.active_vehicle_updates_per_s for rate in rates[simulator.name]]
        vehicles = [rate.mean_active_vehicles for rate in rates[simulator.name]]
        results[simulator.name] = {
            "version": simulator.version(),
            "active_vehicle_updates_per_s": statistics.median(rounds),
            "mean_active_vehicles": statistics.median(vehicles),
            "medjax_ratio": 1.0,
            "rounds": rounds,
            "differences": simulator.differences,
        }
    first = results[simulators[0].name]["active_vehicle_updates_per_s"]
    for result in results.values():
        result["medjax_ratio"] = first / result["active_vehicle_updates_per_s"]
    return results


def compare(options: argparse.Namespace) -> dict[str, Any]:
    """Measures everything; prints the table and the differences."""
    if options.highjax is not None:
        ask(options.highjax)
    skipped = [peer.name for peer in PEERS if installed_version(peer.package) is None]
    for name in skipped:
        say(f'{name}: not installed, skipped (pip install -e ".[peers]")')
    if options.highjax is None:
        skipped.append("HighJax")
        say(f"HighJax: no --highjax, skipped ({INSTALL})")
    env, params = medjax.make(SCENARIO)
    # As with SUMO, one episode is warm-up and another is timed. A part of an episode would not do, since MEDs
    # enter over its course.
    decisions, cores = int(params.episode_decisions), cpu_cores()
    say(f"counting vehicles in {COUNTED_ROADS} roads of medjax")
    num_vehicles = round(Medjax(COUNTED_ROADS, decisions).measure().mean_active_vehicles)
    with tempfile.TemporaryDirectory() as folder:
        world = World(env.config, params, num_vehicles, cores, Path(folder))
        simulators: list[Peer] = [Medjax(options.num_envs, decisions)]
        simulators += [peer(world) for peer in PEERS if peer.name not in skipped]
        if options.highjax is not None:
            # Its cost depends on the number of vehicles: as many as medjax has, and as many as it has by default.
            simulators += [HighJax(options.highjax, n) for n in (num_vehicles, OWN_VEHICLES)]
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
        "simulators": results,
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
    told: dict[tuple[str, ...], list[str]] = {}
    for name, result in comparison["simulators"].items():
        lines.append(
            f"{name:14}{result['version']:>10}{result['mean_active_vehicles']:18.0f}"
            f"{result['active_vehicle_updates_per_s']:14,.0f}{result['medjax_ratio']:14,.1f}"
        )
        told.setdefault(tuple(result["differences"]), []).append(name)
    lines += [f"{name:14}skipped" for name in comparison["skipped"]]
    lines += ["", "What differs:"]
    for differences, names in told.items():
        lines += ["; ".join(names), *(f"  - {difference}" for difference in differences)]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = benchmark_parser("peers", __doc__)
    add_number(parser, "--rounds", 3, "timed rounds")
    add_number(parser, "--num-envs", 1024, "roads that medjax simulates at once")
    own = f"a Python that has HighJax, which needs a newer one than medjax ({INSTALL})"
    parser.add_argument("--highjax", metavar="PYTHON", help=own)
    run_command(parser, compare, arguments)


if __name__ == "__main__":
    main()
