"""SUMO on the road of medjax: a network of netconvert, IDM, the same demand, tick and time span."""

import itertools
import math
import statistics
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from benchmarks.peers import Peer, Rate, World
from medjax.traffic.demand import SPEED_SPREAD, entry_rates
from medjax.world.kinds import EVS, GAS, GAS_KINDS, kinds_in
from medjax.world.params import EnvParams

# medjax's vehicles start on the acceleration lane; SUMO's start this much before it, on a ramp.
RAMP_M = 20.0
HOUR_S = 3600.0


def _write(path: Path, root: str, elements: Iterable[ElementTree.Element]) -> Path:
    tree = ElementTree.Element(root)
    tree.extend(elements)
    ElementTree.ElementTree(tree).write(path)
    return path


def _element(tag: str, **attributes: Any) -> ElementTree.Element:
    return ElementTree.Element(
        tag, {name.rstrip("_"): str(value) for name, value in attributes.items()}
    )


def _ramps(params: EnvParams) -> list[float]:
    return [float(x) for x in np.asarray(params.road.ramp_x_m)]


def _cuts(params: EnvParams) -> list[float]:
    """Positions where the number of lanes changes, and both ends of the road, m."""
    ramps, merge = _ramps(params), float(params.road.acceleration_lane_m)
    ends = {0.0, float(params.road.length_m)}
    return sorted(ends | set(ramps) | {x + merge for x in ramps})


Elements = list[ElementTree.Element]
Network = tuple[Elements, Elements, Elements]  # nodes, edges and connections


def _main_road(params: EnvParams, num_lanes: int, common: Mapping[str, Any]) -> Network:
    """Edges from cut to cut, named by the position of their left end, with an acceleration lane behind each ramp."""
    ramps, cuts = _ramps(params), _cuts(params)
    nodes = [_element("node", id=f"x{x:g}", x=x, y=0) for x in cuts]
    edges, connections = [], []
    for left, right in itertools.pairwise(cuts):
        merging = left in ramps
        ends = {"from_": f"x{left:g}", "to": f"x{right:g}"}
        lanes = num_lanes + merging
        edges.append(_element("edge", id=f"main{left:g}", **ends, numLanes=lanes, **common))
        if right != cuts[-1]:
            joined = {"from_": f"main{left:g}", "to": f"main{right:g}"}
            connections += [
                _element(
                    "connection", **joined, fromLane=lane + merging, toLane=lane + (right in ramps)
                )
                for lane in range(num_lanes)
            ]
    return nodes, edges, connections


def _on_ramps(params: EnvParams, y: float, common: Mapping[str, Any]) -> Network:
    """A short edge to each ramp's acceleration lane, at `y` beside the road so that no two connections cross."""
    nodes, edges, connections = [], [], []
    for x in _ramps(params):
        name, end = f"ramp{x:g}", f"x{x:g}"
        shape = f"{x - RAMP_M},{y} {x},{y}"
        nodes.append(_element("node", id=name, x=x - RAMP_M, y=y))
        edges.append(
            _element("edge", id=name, from_=name, to=end, numLanes=1, shape=shape, **common)
        )
        connections.append(
            _element("connection", from_=name, to=f"main{x:g}", fromLane=0, toLane=0)
        )
    return nodes, edges, connections


def build_network(workload: World) -> Path:
    """The road as netconvert makes it.

    SUMO counts lanes from the right, so the acceleration lane is lane 0 of its edge.
    """
    params, num_lanes, folder = workload.params, workload.config.num_lanes, workload.folder
    width = float(params.road.lane_width_m)
    speed = float(params.drivers.desired_speed[GAS])
    common = {"width": width, "speed": speed, "spreadType": "right"}
    road = _main_road(params, num_lanes, common), _on_ramps(params, -width * num_lanes, common)
    network = folder / "road.net.xml"
    command = ["netconvert", "--no-turnarounds", "true"]
    for kind, parts in zip(("node", "edge", "connection"), zip(*road, strict=True), strict=True):
        file = _write(folder / f"road.{kind}.xml", f"{kind}s", itertools.chain(*parts))
        command += [f"--{kind}-files", str(file)]
    # Edges then meet without lanes of a junction between them: lengths are exact, and SUMO is faster.
    command += ["--no-internal-links", "true", "--output-file", str(network)]
    _finish(_start(command))
    return network


def build_demand(workload: World) -> Path:
    """Drivers of medjax's kinds, and Poisson flows into each lane at x = 0 and onto each ramp."""
    params = workload.params
    demand, drivers = params.demand, params.drivers
    limit = float(drivers.desired_speed[GAS])  # desired speeds are factors of the road's limit
    of_class, ev = demand.class_shares, float(demand.ev_share)
    shares = {kind: ev * float(of_class[kind]) for kind in kinds_in(EVS)}
    shares |= {kind: (1.0 - ev) * float(of_class[kind]) for kind in GAS_KINDS}
    kinds = _element("vTypeDistribution", id="traffic")
    for kind, share in shares.items():
        mean = float(drivers.desired_speed[kind]) / limit
        spread = float(drivers.desired_speed_std[kind]) / limit
        low, high = mean - SPEED_SPREAD * spread, mean + SPEED_SPREAD * spread
        kinds.append(
            _element(
                "vType",
                id=f"kind{kind}",
                probability=share,
                carFollowModel="IDM",
                tau=float(drivers.time_headway[kind]),
                minGap=float(drivers.min_gap[kind]),
                accel=float(drivers.max_acceleration[kind]),
                decel=float(drivers.comfortable_deceleration[kind]),
                emergencyDecel=float(params.motion.max_braking),
                length=float(drivers.vehicle_length[kind]),
                speedFactor=f"normc({mean:.6f},{spread:.6f},{low:.6f},{high:.6f})",
                lcKeepRight=0,  # medjax's traffic has no duty to keep right either
            )
        )
    ramps, mains = _ramps(params), _cuts(params)[:-1]
    paths = {"main0": [f"main{x:g}" for x in mains]}
    for start in ramps:
        onward = [f"main{x:g}" for x in mains if x >= start]
        paths[f"ramp{start:g}"] = [f"ramp{start:g}", *onward]
    routes = [_element("route", id=name, edges=" ".join(path)) for name, path in paths.items()]

    num_lanes = workload.config.num_lanes
    # "max": as fast as its driver wants and the vehicle ahead allows, as medjax's enter.
    entries = [("main0", lane, "max") for lane in range(num_lanes)]
    entries += [(f"ramp{x:g}", 0, str(float(demand.ramp_speed))) for x in ramps]
    rates = np.asarray(entry_rates(demand, num_lanes, 0.0), np.float64)
    flows = [
        _element(
            "flow",
            id=f"{route}lane{lane}",
            type="traffic",
            route=route,
            begin=0,
            end=2.0 * workload.span_s + 1.0,
            period=f"exp({rate:.8f})",  # Poisson arrivals, 1/s
            departLane=lane,
            departSpeed=speed,
        )
        for (route, lane, speed), rate in zip(entries, rates, strict=True)
        if rate > 0.0
    ]
    return _write(workload.folder / "road.rou.xml", "routes", [kinds, *routes, *flows])


def _start(command: list[str]) -> subprocess.Popen[str]:
    import sumo  # the package of PyPI; sets SUMO_HOME, where its programs look for their schemas

    program = Path(sumo.SUMO_HOME) / "bin" / command[0]
    return subprocess.Popen(
        [str(program), *command[1:]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(process: subprocess.Popen[str]) -> None:
    _, errors = process.communicate()
    if process.returncode:
        raise RuntimeError(f"SUMO failed with exit code {process.returncode}: {errors.strip()}")


class Sumo(Peer):
    """The `sumo` program, one process a core at the same time, each with a road of its own."""

    name = "SUMO"
    package = "eclipse-sumo"
    differences = (
        "It moves one road in each process, one process a core at the same time; their rates are added.",
        "It is timed by its own clock over one episode, from a saved state of a road that has filled "
        "for one episode; starting it and loading (about 0.1 s) are left out.",
        "Its lane changes are LC2013, its default: more detailed than MOBIL (it plans for lanes that "
        "end and drivers cooperate), and without a duty to keep right.",
        "It does car following and lane changes only: no MEDs, batteries, charging, driver noise, "
        "observation, reward or reset, and it writes no output but its summary.",
        f"It starts ramp traffic {RAMP_M:g} m before the acceleration lane and counts it there too.",
        "It computes in double precision, medjax in single.",
        "Generous to it: junctions have no lanes of their own, which makes it about a quarter faster.",
    )

    def __init__(self, workload: World) -> None:
        """Builds the network and the demand, and fills one road for each core."""
        self.workload = workload
        self.network = build_network(workload)
        self.demand = build_demand(workload)
        # A state is saved at the start of a step, so one more step has to follow.
        span, tick = workload.span_s, workload.config.tick_s
        self._together(
            [
                self.start(
                    seed,
                    0.0,
                    span + tick,
                    *("--save-state.times", str(span)),
                    *("--save-state.files", str(self._file(seed, "state.xml.gz"))),
                )
                for seed in range(workload.cores)
            ]
        )

    def _file(self, seed: int, name: str) -> Path:
        return self.workload.folder / f"road{seed}.{name}"

    def start(self, seed: int, begin: float, end: float, *options: str) -> subprocess.Popen[str]:
        """Starts SUMO on road `seed` from `begin` to `end` (s); the result goes to its summary."""
        command = ["sumo", "--net-file", str(self.network), "--route-files", str(self.demand)]
        command += ["--begin", str(begin), "--end", str(end), "--seed", str(seed)]
        command += ["--step-length", str(self.workload.config.tick_s)]
        command += ["--step-method.ballistic", "true"]  # the update of medjax
        command += ["--time-to-teleport", "-1"]  # nobody is taken off the road for waiting
        command += ["--no-step-log", "true", "--no-warnings", "true"]
        command += ["--statistic-output", str(self._file(seed, "statistics.xml")), *options]
        return _start(command)

    def resume(self, seed: int, *options: str) -> subprocess.Popen[str]:
        """Starts SUMO on the filled road `seed`, for one episode."""
        span = self.workload.span_s
        state = str(self._file(seed, "state.xml.gz"))
        return self.start(seed, span, 2.0 * span, "--load-state", state, *options)

    def _together(self, processes: list[subprocess.Popen[str]]) -> None:
        try:
            for process in processes:
                _finish(process)
        finally:
            for process in processes:
                process.kill()

    def read(self, seed: int) -> Rate:
        """The rate that SUMO itself counted on road `seed`, of vehicles running in each step."""
        statistics_of_run = ElementTree.parse(self._file(seed, "statistics.xml")).getroot()
        performance = statistics_of_run.find("performance")
        if performance is None:
            raise RuntimeError("SUMO's statistics have no performance")
        rate = float(performance.attrib["vehicleUpdatesPerSecond"])
        # Wall time is given to 0.01 s only; simulated time by the real time factor is finer.
        steps_per_s = float(performance.attrib["realTimeFactor"]) / self.workload.config.tick_s
        return Rate(rate, rate / steps_per_s)

    def measure(self) -> Rate:
        """One episode of all roads at the same time."""
        seeds = range(self.workload.cores)
        self._together([self.resume(seed) for seed in seeds])
        rates = [self.read(seed) for seed in seeds]
        return Rate(
            math.fsum(rate.active_vehicle_updates_per_s for rate in rates),
            statistics.fmean(rate.mean_active_vehicles for rate in rates),
        )
