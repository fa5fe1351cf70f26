"""Travel times in medjax and in SUMO, a list of episodes for each way."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from benchmarks.peers import sumo_road
from benchmarks.verification.own_road.ways import Way
from benchmarks.verification.validation.demands import Schedule
from benchmarks.verification.validation.medjax_side import record
from benchmarks.verification.validation.trajectories import Trajectories
from medjax.env.charging_env import ChargingEnv
from medjax.world.params import EnvConfig, EnvParams

# Before the minutes in which measured vehicles enter, and after. Who has not left at the end is not counted, so the
# time to leave has to be longer than the longest travel time in a queue.
FILL_MINUTES, LEAVE_MINUTES = 5, 15
NEAR_M = 60.0  # a vehicle's last tick is nearer than this to where it leaves the road

Times = list[list[np.ndarray]]  # s; an array for each way and episode


def medjax_times(
    env: ChargingEnv, params: EnvParams, ways: Sequence[Way], minutes: int, seeds: range
) -> Times:
    """Travel times in medjax, from every vehicle's place at every tick."""
    schedule = Schedule(env.config, lambda _: params, minutes + LEAVE_MINUTES, FILL_MINUTES)
    seen = record(env, schedule, len(seeds), seeds[0])
    episodes = [times_of(each, ways, 60.0 * minutes) for each in seen]
    return [list(of_way) for of_way in zip(*episodes, strict=True)]


def times_of(seen: Trajectories, ways: Sequence[Way], span_s: float) -> list[np.ndarray]:
    """Travel times, s, on each way, of vehicles that enter within `span_s` and leave while they are observed."""
    found: list[list[float]] = [[] for _ in ways]
    new = np.nonzero(np.r_[True, ~seen.goes_on])[0]
    for first, last in zip(new.tolist(), [*(new[1:] - 1).tolist(), len(seen.x) - 1], strict=True):
        if not 0.0 < seen.tick[first] * seen.tick_s < span_s:
            continue
        begin, end = seen.x[first], seen.x[last]
        for number, way in enumerate(ways):
            by_ramp = bool(seen.on_ramp[first])
            near_m = NEAR_M + (seen.road.acceleration_lane_m if by_ramp else 0.0)
            comes = by_ramp == (way.before is not None) and abs(begin - way.begin_m) < near_m
            if comes and way.until_m - NEAR_M < end < way.end_m + NEAR_M:
                found[number].append(_time(seen, first, last, way))
    return [np.array(times) for times in found]


def _time(seen: Trajectories, first: int, last: int, way: Way) -> float:
    """Time from a way's beginning to where it is measured, s; beyond its rows a vehicle keeps their speed."""
    x, speed = seen.x[first : last + 1], seen.speed[first : last + 1]
    ticks = np.interp(way.until_m, x, np.arange(len(x)))
    beyond = max(way.until_m - x[-1], 0.0) / max(speed[-1], 1.0)
    return float(ticks * seen.tick_s + beyond + (x[0] - way.begin_m) / max(speed[0], 1.0))


def sumo_times(
    file: Path,
    world: tuple[EnvConfig, EnvParams],
    ways: Sequence[Way],
    minutes: int,
    seeds: range,
) -> Times:
    """Travel times in SUMO on the network itself, from when each vehicle leaves each edge."""
    end_s = 60.0 * (FILL_MINUTES + minutes + LEAVE_MINUTES)
    times: Times = [[] for _ in ways]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = ["sumo", "--net-file", str(file)]
        command += ["--route-files", str(_demand(world, ways, end_s, folder))]
        command += ["--begin", "0", "--end", str(end_s), "--step-length", str(world[0].tick_s)]
        command += ["--step-method.ballistic", "true", "--time-to-teleport", "-1"]
        command += ["--no-step-log", "true", "--no-warnings", "true"]
        for seed in seeds:
            output = folder / f"{seed}.xml"
            own = ["--seed", str(seed), "--vehroute-output", str(output)]
            sumo_road.finish(
                sumo_road.start([*command, *own, "--vehroute-output.exit-times", "true"])
            )
            found: list[list[float]] = [[] for _ in ways]
            for number, entered_s, time_s in _driven(output, ways):
                if 0.0 < entered_s - 60.0 * FILL_MINUTES < 60.0 * minutes:
                    found[number].append(time_s)
            for each, driven in zip(times, found, strict=True):
                each.append(np.array(driven))
    return times


def _demand(
    world: tuple[EnvConfig, EnvParams], ways: Sequence[Way], end_s: float, folder: Path
) -> Path:
    """Poisson flows of the preset's drivers along each way; on the motorway they are equal in all lanes."""
    config, params = world
    routes, flows = [], []
    for number, way in enumerate(ways):
        beside = [(edge,) if edge else () for edge in (way.before, way.after)]
        edges = " ".join([*beside[0], *way.along, *beside[1]])
        routes.append(sumo_road.element("route", id=f"way{number}", edges=edges))
        lanes = ["random"] if way.before else list(range(config.num_lanes))
        flows += [
            sumo_road.element(
                "flow",
                id=f"{number}.{lane}.",
                type="traffic",
                route=f"way{number}",
                begin=0,
                end=end_s,
                period=f"exp({way.per_h / 3600.0 / len(lanes):.8f})",  # 1/s
                departLane=lane,
                departSpeed="last",  # with "max" SUMO admits fewer vehicles
            )
            for lane in lanes
            if way.per_h > 0.0
        ]
    elements = [sumo_road.kinds_of(params), *routes, *flows]
    return sumo_road.write_xml(folder / "road.rou.xml", "routes", elements)


def _driven(file: Path, ways: Sequence[Way]) -> Iterator[tuple[int, float, float]]:
    """Way, time of entry and travel time, s, of each vehicle that arrived."""
    for vehicle in ElementTree.parse(file).getroot().iterfind("vehicle"):
        number, route = int(vehicle.attrib["id"].partition(".")[0]), vehicle.find("route")
        if route is None or "arrival" not in vehicle.attrib:
            continue
        way, left = ways[number], [float(time) for time in route.attrib["exitTimes"].split()]
        entered = left.pop(0) if way.before else float(vehicle.attrib["depart"])
        # On a way to an exit the time ends where the last edge before the exit begins.
        edges = len(way.along) - (way.after is not None)
        yield number, entered, left[edges - 1] - entered
