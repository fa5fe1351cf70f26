"""`python -m benchmarks.scaling`: whether the cost per vehicle stays constant as the workload grows.

It varies the number of environments, of vehicles on a road (longer roads at the same demand), and of devices (on a CPU,
cores). It also reports the cost of a reset and the memory of an environment.
"""

import argparse
import dataclasses
import statistics
import time
from typing import Any

import jax

from benchmarks.command import add_number, add_scenario, benchmark_parser, run_command
from benchmarks.speed.workload import ENVS, VEHICLES, Measurement, Workload, alternate, road_for


def cost_ns(result: Measurement) -> float:
    """Wall time per active vehicle and tick, ns."""
    return 1e9 / result.active_vehicle_updates_per_s


def spread(results: list[Measurement]) -> float:
    """Ratio of the highest to the lowest cost per vehicle."""
    costs = [cost_ns(result) for result in results]
    return max(costs) / min(costs)


def reset_in_decisions(num_envs: int, repeats: int, scenario: str) -> float:
    """Time to reset all environments, relative to one decision in all of them."""
    work = Workload(num_envs, steps=20, scenario=scenario)
    work.play()
    decision_s = statistics.median(work.play()[0] for _ in range(repeats)) / work.steps
    walls = []
    for number in range(repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(work.reset(jax.random.key(number)))
        walls.append(time.perf_counter() - start)
    return statistics.median(walls[1:]) / decision_s


def show(title: str, column: str, rows: list[tuple[Any, Measurement]]) -> None:
    """Prints a table and the spread of its costs."""
    headings = "environments  vehicles a road  M updates/s  ns a vehicle and tick"
    print(f"\n{title}\n{column:>12}  {headings}")
    for name, result in rows:
        print(
            f"{name:>12}  {result.num_envs:>12}  {result.mean_active_vehicles:>15.0f}"
            f"  {result.active_vehicle_updates_per_s / 1e6:>11.2f}  {cost_ns(result):>21.1f}"
        )
    print(f"dearest by cheapest: {spread([result for _, result in rows]):.2f}", flush=True)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the tables and returns all figures."""
    most, scenario = options.num_envs, options.scenario
    lengths = {count: road_for(count, scenario) for count in VEHICLES}

    def compare(title: str, column: str, works: dict[int, Workload]) -> list[Measurement]:
        results = alternate(list(works.values()), options.repeats)
        show(title, column, list(zip(works, results, strict=True)))
        return results

    def sized(num_envs: int, **changes: Any) -> Workload:
        # A constant total of decisions makes all measurements take about as long.
        return Workload(num_envs, max(4, 50 * most // num_envs), scenario=scenario, **changes)

    tables = {"envs": compare("over environments", "environments", {n: sized(n) for n in ENVS})}
    roads = {
        n: Workload(max(1, most * VEHICLES[0] // n), 50, scenario=scenario, **length)
        for n, length in lengths.items()
    }
    tables["vehicles"] = compare("over vehicles on a road", "asked for", roads)
    counts = [n for n in range(1, len(jax.local_devices()) + 1) if most % n == 0]
    shares = {n: sized(most, num_devices=n) for n in counts}
    tables["devices"] = compare("over devices", "devices", shares)
    reset = reset_in_decisions(most, options.repeats, scenario)
    print(f"\na reset costs as much as {reset:.2f} decisions")
    here = tables["devices"][-1]
    state, work = here.state_bytes_per_env / 1024, here.work_bytes_per_env / 1024
    print(f"an environment takes {state:.1f} KiB of state and {work:.1f} KiB of work space")
    figures: dict[str, Any] = {
        name: [dataclasses.asdict(result) for result in results] for name, results in tables.items()
    }
    figures |= {f"{name}_spread": spread(results) for name, results in tables.items()}
    return figures | {"reset_in_decisions": reset}


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("scaling", __doc__)
    add_number(parser, "--num-envs", 1024, "environments side by side")
    add_number(parser, "--repeats", 5, "timings per case")
    add_scenario(parser)
    run_command(parser, measure, arguments)
