"""The road and the demand of medjax as files for SUMO."""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from medjax.traffic.demand import SPEED_SPREAD, entry_rates
from medjax.world.kinds import EVS, GAS, GAS_KINDS, kinds_in
from medjax.world.params import EnvConfig, EnvParams

# Length of the ramp on which SUMO's vehicles start; medjax's start on the acceleration lane itself.
RAMP_M = 20.0


def write_xml(path: Path, root: str, elements: Iterable[ElementTree.Element]) -> Path:
    """Writes elements under one root; returns the file."""
    tree = ElementTree.Element(root)
    tree.extend(elements)
    ElementTree.ElementTree(tree).write(path)
    return path


def element(tag: str, **attributes: Any) -> ElementTree.Element:
    """An element; an attribute whose name is a word of Python takes an underscore behind it, such as `from_`."""
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


class Period(NamedTuple):
    """A demand and the time that it lasts."""

    begin_s: float
    end_s: float
    params: EnvParams


def _parts(config: EnvConfig, params: EnvParams) -> dict[str, list[ElementTree.Element]]:
    """Nodes, edges and connections of the road.

    Edges of the main road go from cut to cut and are named by the position of their left end; those at ramps have an
    acceleration lane, which a short edge leads to.
    """
    num_lanes, width = config.num_lanes, float(params.road.lane_width_m)
    speed = float(params.drivers.desired_speed[GAS])
    common = {"width": width, "speed": speed, "spreadType": "right"}
    ramps, cuts = _ramps(params), _cuts(params)
    parts: dict[str, list[ElementTree.Element]] = {"node": [], "edge": [], "connection": []}

    def add(kind: str, **attributes: Any) -> None:
        parts[kind].append(element(kind, **attributes))

    for x in cuts:
        add("node", id=f"x{x:g}", x=x, y=0)
    for left, right in itertools.pairwise(cuts):
        merging, name = left in ramps, f"main{left:g}"
        ends = {"from_": f"x{left:g}", "to": f"x{right:g}"}
        add("edge", id=name, **ends, numLanes=num_lanes + merging, **common)
        for lane in range(num_lanes if right != cuts[-1] else 0):
            lanes = {"fromLane": lane + merging, "toLane": lane + (right in ramps)}
            add("connection", from_=name, to=f"main{right:g}", **lanes)
    y = -width * num_lanes  # beside the road, so that no connections cross
    for x in ramps:
        name = f"ramp{x:g}"
        add("node", id=name, x=x - RAMP_M, y=y)
        # An explicit length, since netconvert extends the shape to the middle of the node.
        of_ramp = {"numLanes": 1, "shape": f"{x - RAMP_M},{y} {x},{y}", "length": RAMP_M}
        add("edge", id=name, from_=name, to=f"x{x:g}", **of_ramp, **common)
        add("connection", from_=name, to=f"main{x:g}", fromLane=0, toLane=0)
    return parts


def build_network(config: EnvConfig, params: EnvParams, folder: Path) -> Path:
    """Builds the road with netconvert and returns its file.

    SUMO counts lanes from the right, so the acceleration lane is lane 0 of its edge.
    """
    network = folder / "road.net.xml"
    command = ["netconvert", "--no-turnarounds", "true"]
    for kind, elements in _parts(config, params).items():
        file = write_xml(folder / f"road.{kind}.xml", f"{kind}s", elements)
        command += [f"--{kind}-files", str(file)]
    # Without internal junction lanes, lengths are exact and SUMO is faster.
    command += ["--no-internal-links", "true", "--output-file", str(network)]
    finish(start(command))
    return network


def lanes_of_network(config: EnvConfig, params: EnvParams) -> dict[str, tuple[float, int]]:
    """The start (m) and medjax's number of each lane of `build_network`, by SUMO's name of the lane."""
    ramps, num_lanes = _ramps(params), config.num_lanes
    found = {f"ramp{x:g}_0": (x - RAMP_M, num_lanes) for x in ramps}
    for left in _cuts(params)[:-1]:
        rightmost = num_lanes if left in ramps else num_lanes - 1
        found |= {f"main{left:g}_{rightmost - lane}": (left, lane) for lane in range(rightmost + 1)}
    return found


def kinds_of(params: EnvParams) -> ElementTree.Element:
    """The distribution `traffic` of vehicle types: medjax's kinds, with the same shares."""
    demand, drivers = params.demand, params.drivers
    limit = float(drivers.desired_speed[GAS])  # SUMO wants desired speeds as factors of the limit
    of_class, ev = demand.class_shares, float(demand.ev_share)
    shares = {kind: ev * float(of_class[kind]) for kind in kinds_in(EVS)}
    shares |= {kind: (1.0 - ev) * float(of_class[kind]) for kind in GAS_KINDS}
    kinds = element("vTypeDistribution", id="traffic")
    for kind, share in shares.items():
        mean = float(drivers.desired_speed[kind]) / limit
        spread = float(drivers.desired_speed_std[kind]) / limit
        low, high = mean - SPEED_SPREAD * spread, mean + SPEED_SPREAD * spread
        kinds.append(
            element(
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
                lcKeepRight=0,  # as in medjax, nobody has to keep right
            )
        )
    return kinds


def _flows(config: EnvConfig, period: Period) -> list[ElementTree.Element]:
    """Poisson arrivals at each entry in a period; SUMO wants flows in the order of their start times."""
    demand = period.params.demand
    # "last" enters as fast as the vehicle ahead. With "max" SUMO admits at most 1,000 vehicles per hour and lane, some
    # of them at a crawl, which then hold up others.
    entries = [("main0", lane, "last") for lane in range(config.num_lanes)]
    entries += [(f"ramp{x:g}", 0, str(float(demand.ramp_speed))) for x in _ramps(period.params)]
    rates = np.asarray(entry_rates(demand, config.num_lanes, 0.0), np.float64)
    return [
        element(
            "flow",
            id=f"{route}lane{lane}from{period.begin_s:g}",
            type="traffic",
            route=route,
            begin=period.begin_s,
            end=period.end_s,
            period=f"exp({rate:.8f})",  # 1/s
            departLane=lane,
            departSpeed=speed,
        )
        for (route, lane, speed), rate in zip(entries, rates, strict=True)
        if rate > 0.0
    ]


def build_demand(config: EnvConfig, periods: Sequence[Period], folder: Path) -> Path:
    """Writes medjax's kinds of vehicles, and Poisson flows into each lane at x = 0 and onto each ramp.

    Args:
      periods: consecutive periods with the same road and drivers; their demands may differ.
      folder: for the file.
    """
    params = periods[0].params
    ramps, mains = _ramps(params), _cuts(params)[:-1]
    paths = {"main0": [f"main{x:g}" for x in mains]}
    for begin in ramps:
        onward = [f"main{x:g}" for x in mains if x >= begin]
        paths[f"ramp{begin:g}"] = [f"ramp{begin:g}", *onward]
    routes = [element("route", id=name, edges=" ".join(path)) for name, path in paths.items()]
    flows = itertools.chain.from_iterable(_flows(config, period) for period in periods)
    return write_xml(folder / "road.rou.xml", "routes", [kinds_of(params), *routes, *flows])


def start(command: list[str]) -> subprocess.Popen[str]:
    """Starts one of SUMO's programs without printing its messages."""
    import sumo  # PyPI's package; sets SUMO_HOME, where the programs look for their schemas

    program = Path(sumo.SUMO_HOME) / "bin" / command[0]
    return subprocess.Popen(
        [str(program), *command[1:]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> None:
    """Waits for a process; raises RuntimeError with its message if it fails."""
    _, errors = process.communicate()
    if process.returncode:
        raise RuntimeError(f"SUMO failed with exit code {process.returncode}: {errors.strip()}")
