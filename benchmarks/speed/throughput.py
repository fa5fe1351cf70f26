"""`python -m benchmarks.throughput`: how many active vehicle updates medjax computes per second.

The command times the complete default step under uniformly random actions: dispatch, entries, booking, ticks,
observation, reward, metrics and auto-reset. Only vehicles that are on the road count.
"""

import argparse
import dataclasses
from typing import Any

from benchmarks.command import add_number, add_scenario, benchmark_parser, natural, run_command
from benchmarks.speed.stages import stage_times
from benchmarks.speed.workload import ENVS, VEHICLES, Measurement, Workload, measure, road_for
from medjax.errors import InputError
from medjax.wrappers import environment_mesh

NUM_ENVS = 1024  # unless told otherwise


def show(result: Measurement) -> None:
    """Prints a measurement in one line."""
    print(
        f"{result.num_envs:6d} environments: {result.active_vehicle_updates_per_s / 1e6:6.2f} M active "
        f"vehicle updates/s, {result.env_steps_per_s:8.0f} decisions/s, "
        f"{result.mean_active_vehicles:.0f} vehicles a road, compiled in {result.compile_s:.1f} s",
        flush=True,
    )


def show_stages(times: dict[str, float]) -> None:
    """Prints each stage's share of the time of all cores."""
    total = sum(times.values())
    print("\nstage                 share")
    for name, seconds in sorted(times.items(), key=lambda item: -item[1]):
        print(f"{name:<20}{100 * seconds / total:6.1f} %")


def cases_of(options: argparse.Namespace) -> list[tuple[int, dict[str, Any]]]:
    """Number of environments and overrides of each requested measurement.

    Raises:
      InputError: an option that another one leaves without effect, or a preset that has no roads of other lengths.
    """
    sizes = options.num_envs or [NUM_ENVS]
    if options.sweep == "envs" and options.num_envs:
        raise InputError("--num-envs: allowed without --sweep envs, which has its own numbers")
    if options.sweep == "vehicles" and len(sizes) > 1:
        raise InputError("--num-envs: allowed one number with --sweep vehicles")
    if options.stages and (options.sweep or len(sizes) > 1):
        raise InputError("--stages: allowed without --sweep, and with one number of --num-envs")
    if options.sweep == "envs":
        return [(num_envs, {}) for num_envs in ENVS]
    if options.sweep == "vehicles":
        # With a constant total of vehicles only the length of a road differs.
        most, scenario = sizes[0] * VEHICLES[0], options.scenario
        return [(max(1, most // count), road_for(count, scenario)) for count in VEHICLES]
    return [(num_envs, {}) for num_envs in sizes]


def time_cases(options: argparse.Namespace) -> Any:
    """Prints one line per measurement; returns the result, or a list if there are several."""
    cases = cases_of(options)
    common = {"scenario": options.scenario, "num_devices": options.num_devices}
    for num_envs, _ in cases:  # refuses bad sizes before anything is compiled
        environment_mesh(num_envs, options.num_devices)
    results, steps, repeats = [], options.steps, options.repeats
    for num_envs, overrides in cases:
        result = measure(num_envs, steps=steps, repeats=repeats, **common, **overrides)
        results.append(dataclasses.asdict(result))
        show(result)
    if options.stages:
        num_envs, overrides = cases[0]
        work = Workload(num_envs, steps=8, **common, **overrides)
        results[0]["stage_seconds"] = times = stage_times(work)
        show_stages(times)
    return results[0] if len(results) == 1 else results


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("throughput", __doc__)
    shown = "environments side by side; several numbers are timed one after the other"
    add_number(parser, "--num-envs", [NUM_ENVS], shown, nargs="+")
    parser.set_defaults(num_envs=None)  # so that a given number is told from the default
    shown = f"time {ENVS} environments, or roads of {VEHICLES} vehicles"
    parser.add_argument("--sweep", choices=("envs", "vehicles"), help=shown)
    shown = "show how a decision's time splits into stages"
    parser.add_argument("--stages", action="store_true", help=shown)
    add_number(parser, "--steps", 50, "decisions per timing")
    add_number(parser, "--repeats", 5, "timings per case")
    add_scenario(parser)
    add_number(parser, "--num-devices", 0, "number of devices or CPU cores; 0: all", natural)
    run_command(parser, time_cases, arguments)
