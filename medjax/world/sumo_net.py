"""A road from a network of SUMO."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from medjax.commandline import as_path
from medjax.errors import InputError, shown
from medjax.files import check_input

# Lorries and MEDs desire at most this, m/s, whatever the limit for cars; as `drivers.desired_speed` of lorries.
LORRY_M_PER_S = 23.6


@dataclasses.dataclass(frozen=True)
class Edge:
    """An edge of the network; lengths are those of its lanes, since netconvert moves and stretches edges."""

    lanes: int
    length_m: float
    limit_m_per_s: float
    is_motorway: bool


@dataclasses.dataclass(frozen=True)
class Network:
    """Edges by name, and from which edge to which a connection leads: the length of the way between, m."""

    edges: dict[str, Edge]
    ways: dict[tuple[str, str], float]

    def after(self, name: str) -> list[str]:
        """Edges that follow an edge."""
        return [then for first, then in self.ways if first == name]

    def before(self, name: str) -> list[str]:
        """Edges that lead to an edge."""
        return [first for first, then in self.ways if then == name]


def read_sumo_net(file: str | PathLike[str], edges: Sequence[str] | None = None) -> dict[str, Any]:
    """Reads a motorway from a network of SUMO: `medjax.make("corridor", road=read_sumo_net("my.net.xml"))`.

    Positions are sums of lanes' lengths. An edge that joins between two edges of the motorway is a ramp, one that
    leaves there is an exit. Lanes beyond those that the whole motorway has are acceleration and deceleration lanes. A
    warning says what the model of a road cannot show: numbers of lanes, limits or lengths of such lanes that change.

    Args:
      file: a network that netconvert wrote, for example from OpenStreetMap.
      edges: names of the motorway's edges in driving order; None takes the longest motorway (`highway.motorway`).

    Returns:
      Numbers by name for `medjax.make`: `length_m`, `num_lanes`, `ramp_x_m`, `exit_x_m`, `acceleration_lane_m` and
      `exit_lane_m` where there are any, and desired speeds, which are the limit, or a lorry's speed below it.

    Raises:
      InputError: the file is no network of SUMO, has no motorway, or the edges are not in it or do not follow another.
    """
    path = as_path("file", file)
    check_input("file", path)
    network = read_network(path)
    return _road(path, network, motorway_of(path, network, edges))


def motorway_of(path: Path, network: Network, edges: Sequence[str] | None) -> list[str]:
    """The edges that `read_sumo_net` takes, in driving order; `path` is for its errors."""
    return _longest_motorway(path, network) if edges is None else _given(path, network, edges)


def read_network(path: Path) -> Network:
    """The network of a file; raises InputError if it is none of SUMO."""
    try:
        root = ElementTree.parse(path).getroot()
        if root.tag != "net":
            raise ValueError(f"its root is {root.tag}")
        lanes = {edge.attrib["id"]: (edge, edge.findall("lane")) for edge in root.iterfind("edge")}
        lengths = {
            lane.attrib["id"]: float(lane.attrib["length"])
            for _, of_edge in lanes.values()
            for lane in of_edge
        }
        edges = {
            name: Edge(
                len(of_edge),
                lengths[of_edge[0].attrib["id"]],
                max(float(lane.attrib["speed"]) for lane in of_edge),
                edge.get("type", "").endswith("motorway"),
            )
            for name, (edge, of_edge) in lanes.items()
            if edge.get("function", "normal") == "normal"
        }
        ways = {
            (way.attrib["from"], way.attrib["to"]): lengths.get(way.get("via", ""), 0.0)
            for way in root.iterfind("connection")
            if way.attrib["from"] in edges and way.attrib["to"] in edges
        }
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(f"{path}: allowed a network of SUMO (net.xml); {error}") from None
    return Network(edges, ways)


def _longest_motorway(path: Path, network: Network) -> list[str]:
    """The longest chain of motorway edges."""
    motorway = {name for name, edge in network.edges.items() if edge.is_motorway}
    starts = sorted(name for name in motorway if not motorway.intersection(network.before(name)))
    # A ring road has no start; it begins anywhere.
    chains = [_onward(network, name, motorway) for name in starts or sorted(motorway)[:1]]
    if not chains:
        raise InputError(
            f"{path}: no edge of type highway.motorway: allowed a network with one, or edges=[...]"
        )
    return max(chains, key=lambda chain: sum(network.edges[name].length_m for name in chain))


def _onward(network: Network, name: str, motorway: Iterable[str]) -> list[str]:
    """The motorway from an edge on; where it forks, along the edge with more lanes."""
    chain = [name]
    while onward := [then for then in network.after(chain[-1]) if then in motorway]:
        then = max(onward, key=lambda each: network.edges[each].lanes)
        if then in chain:
            break
        chain.append(then)
    return chain


def _given(path: Path, network: Network, edges: Sequence[str]) -> list[str]:
    """The given edges, checked."""
    chain = [edges] if isinstance(edges, str) else edges
    if not isinstance(chain, list | tuple) or not chain:
        raise InputError(f"edges = {shown(edges)}: allowed names of edges in driving order")
    for name in chain:
        if not isinstance(name, str) or name not in network.edges:
            raise InputError(f"edges has {shown(name)}: allowed edges of {path}")
    for first, then in itertools.pairwise(chain):
        if (first, then) not in network.ways:
            onward = ", ".join(network.after(first)) or "none"
            raise InputError(f"edge {shown(then)} after {shown(first)}: allowed one of {onward}")
    return list(chain)


def joining(network: Network, chain: Sequence[str]) -> dict[int, str]:
    """Ramps: the edge that joins the motorway, by the number of the motorway's edge that begins there."""
    return _beside({i: network.before(chain[i]) for i in range(1, len(chain))}, chain)


def leaving(network: Network, chain: Sequence[str]) -> dict[int, str]:
    """Exits: the edge that leaves the motorway, by the number of the motorway's edge that ends there."""
    return _beside({i: network.after(chain[i]) for i in range(len(chain) - 1)}, chain)


def _beside(nearby: dict[int, list[str]], chain: Sequence[str]) -> dict[int, str]:
    """The first of the edges near each edge that is not of the motorway, where there is one."""
    outside = {i: [name for name in names if name not in chain] for i, names in nearby.items()}
    return {i: names[0] for i, names in outside.items() if names}


def _road(path: Path, network: Network, chain: list[str]) -> dict[str, Any]:
    """The numbers of a road, with a warning for each thing that it cannot show."""
    edges = [network.edges[name] for name in chain]
    lanes = min(edge.lanes for edge in edges)
    starts, ends, x = [], [], 0.0
    for number, name in enumerate(chain):
        x += network.ways[chain[number - 1], name] if number else 0.0
        starts.append(x)
        x += edges[number].length_m
        ends.append(x)

    def beside(numbers: Iterable[int]) -> list[int]:
        """The first of these edges that have an additional lane."""
        return list(itertools.takewhile(lambda number: edges[number].lanes > lanes, numbers))

    last = len(chain) - 1
    joins, leaves = list(joining(network, chain)), list(leaving(network, chain))
    # Edges along which each ramp's and each exit's additional lane runs.
    accelerate = [beside(range(i, last + 1)) for i in joins]
    decelerate = [beside(range(i, -1, -1)) for i in leaves]
    limits = [edge.limit_m_per_s for edge in edges]
    limit = float(np.average(limits, weights=[edge.length_m for edge in edges]))
    slow = min(limit, LORRY_M_PER_S)
    road: dict[str, Any] = {
        "length_m": x,
        "num_lanes": lanes,
        "ramp_x_m": [starts[i] for i in joins],
        "exit_x_m": [ends[i] for i in leaves],
        "desired_speed": [slow, limit, limit, limit, slow],
    }
    used = {number for along in (*accelerate, *decelerate) for number in along}
    notes = []
    if any(edge.lanes > lanes + (number in used) for number, edge in enumerate(edges)):
        notes.append(f"it has more than {lanes} lanes and one beside them at ramps and exits")
    if min(limits) < max(limits):
        notes.append(f"its limits are {min(limits):g} to {max(limits):g} m/s, taken as their mean")
    for name, what, along in (
        ("acceleration_lane_m", "acceleration", accelerate),
        ("exit_lane_m", "deceleration", decelerate),
    ):
        lengths = [sum(edges[number].length_m for number in each) for each in along]
        there = [length for length in lengths if length]
        if there:
            road[name] = sum(there) / len(there)
        if len({round(length) for length in lengths}) > 1 or len(there) < len(lengths):
            each = ", ".join(f"{length:.0f}" for length in lengths)
            taken = f"all are taken as {road[name]:.0f} m" if there else "the preset's length stays"
            notes.append(f"its {what} lanes are {each} m long; {taken}")
    for note in notes:
        warnings.warn(f"{path}: {note}", stacklevel=3)
    return road
