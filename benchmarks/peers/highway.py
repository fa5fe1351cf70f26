"""highway-env on a straight road of medjax's length, lanes and number of vehicles."""

import dataclasses
import multiprocessing
import multiprocessing.synchronize
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from benchmarks.peers import Peer, Rate, World
from medjax.world.kinds import GAS

SPAN_S = 10.0  # simulated; an episode's 600 s would take minutes at the same cost per tick
WARM_UP_S = 1.0
PATIENCE_S = 120.0  # limit for all workers to be ready
START_SPEED = 25.0  # m/s, as in highway-env's own HighwayEnv


@dataclasses.dataclass(frozen=True)
class Traffic:
    """The plain numbers that a worker process needs."""

    length_m: float
    num_lanes: int
    num_vehicles: int
    tick_s: float
    desired_speed: float  # m/s
    desired_speed_std: float


def build_road(traffic: Traffic, seed: int) -> Any:
    """A straight road with IDM vehicles at jittered even spacings, one lane after the other.

    They start far enough from the end that none leaves while they are timed, since highway-env adds no new ones.
    """
    from highway_env.road.road import Road, RoadNetwork
    from highway_env.vehicle.behavior import IDMVehicle

    random = np.random.RandomState(seed)
    desired = random.normal(traffic.desired_speed, traffic.desired_speed_std, traffic.num_vehicles)
    fastest = float(desired.max())
    network = RoadNetwork.straight_road_network(
        lanes=traffic.num_lanes, length=traffic.length_m, speed_limit=fastest
    )
    road = Road(network=network, np_random=random)
    room = traffic.length_m - fastest * (WARM_UP_S + SPAN_S)
    places = np.arange(traffic.num_vehicles) + random.uniform(size=traffic.num_vehicles)
    for i, x in enumerate(places / traffic.num_vehicles * room):
        lane = network.get_lane(("0", "1", i % traffic.num_lanes))
        vehicle = IDMVehicle(
            road, lane.position(x, 0.0), speed=START_SPEED, target_speed=float(desired[i])
        )
        vehicle.randomize_behavior()
        vehicle.check_collisions = False  # as in highway-fast-v0, its faster environment
        road.vehicles.append(vehicle)
    return road


def move(road: Any, traffic: Traffic, ticks: int) -> int:
    """Moves the road; returns the vehicle updates, which are the vehicles on it summed over ticks."""
    updates = 0
    for _ in range(ticks):
        updates += sum(0.0 <= vehicle.position[0] <= traffic.length_m for vehicle in road.vehicles)
        road.act()
        road.step(traffic.tick_s)
    return updates


_together: multiprocessing.synchronize.Barrier | None = None


def _join(barrier: multiprocessing.synchronize.Barrier) -> None:
    global _together
    _together = barrier


def _work(traffic: Traffic, seed: int) -> Rate:
    """One worker's measurement; all workers start together."""
    road = build_road(traffic, seed)
    move(road, traffic, round(WARM_UP_S / traffic.tick_s))
    if _together is not None:
        _together.wait(timeout=PATIENCE_S)
    ticks = round(SPAN_S / traffic.tick_s)
    start = time.perf_counter()
    updates = move(road, traffic, ticks)
    return Rate(updates / (time.perf_counter() - start), updates / ticks)


class HighwayEnv(Peer):
    """highway-env's road physics in one process per core."""

    name = "highway-env"
    package = "highway-env"
    differences = (
        "It moves one road in each process, one process a core at the same time; their rates are added.",
        "It has the same length, lanes, tick and number of vehicles, but neither ramps nor demand: its "
        f"vehicles are placed, and timed over {SPAN_S:g} s, within which none reaches the end.",
        "It is written in Python, and every vehicle looks through all others for its neighbours, so "
        "its cost grows with the square of their number.",
        "Its IDM and MOBIL keep its own parameters; vehicles steer by a bicycle model, where "
        "medjax relaxes their lateral offset.",
        "It does car following, lane changes and steering only: no batteries, charging or driver noise.",
        "It computes in double precision, medjax in single.",
        "Generous to it: the road is moved directly (road.act, road.step), without observation, "
        "reward or reset, and without collision checks, as in highway-fast-v0.",
    )

    def __init__(self, workload: World) -> None:
        """Takes the plain numbers of medjax's world."""
        road, drivers = workload.params.road, workload.params.drivers
        self.cores = workload.cores
        self.traffic = Traffic(
            length_m=float(road.length_m),
            num_lanes=workload.config.num_lanes,
            num_vehicles=workload.num_vehicles,
            tick_s=workload.config.tick_s,
            desired_speed=float(drivers.desired_speed[GAS]),
            desired_speed_std=float(drivers.desired_speed_std[GAS]),
        )

    def measure(self) -> Rate:
        """Times one span of all roads at the same time."""
        # Processes are spawned, since forking a process with JAX's threads may hang.
        context = multiprocessing.get_context("spawn")
        barrier = context.Barrier(self.cores)
        # An executor raises if a worker dies; a Pool would start new ones forever.
        with ProcessPoolExecutor(
            self.cores, mp_context=context, initializer=_join, initargs=(barrier,)
        ) as pool:
            return Rate.added(list(pool.map(_work, [self.traffic] * self.cores, range(self.cores))))
