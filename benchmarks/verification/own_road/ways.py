"""The ways along a motorway, and `corridor` on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

import medjax
from medjax.env.charging_env import ChargingEnv
from medjax.traffic.idm import IDM
from medjax.world.params import EnvParams
from medjax.world.sumo_net import Network, joining, leaving

SLOTS_PER_LANE_KM = 90.0  # of a queue


class Way(NamedTuple):
    """A way from the motorway's beginning or a ramp to its end or an exit, and its edges in SUMO.

    To an exit it is measured as far as the beginning of the last edge before the exit, since vehicles leave the
    motorway anywhere along that edge.
    """

    begin_m: float
    until_m: float  # measured as far as here
    end_m: float
    before: str | None  # the edge that the vehicle comes from; none: the motorway begins here
    along: tuple[str, ...]  # edges of the motorway
    after: str | None  # the edge that it leaves by; none: the motorway ends here
    per_h: float  # vehicles that ask to drive it


def ways_of(network: Network, chain: Sequence[str], params: EnvParams) -> list[Way]:
    """All ways along a motorway; vehicles leave at each exit with `exit_share`."""
    demand, road = params.demand, params.road
    entries: list[tuple[int, str | None]] = [(0, None), *joining(network, chain).items()]
    begins = [0.0, *np.asarray(road.ramp_x_m, float)]
    asked = [float(demand.mainline_per_h), *np.asarray(demand.ramp_per_h, float)]
    exits = leaving(network, chain).items()
    ends, shares = np.asarray(road.exit_x_m, float), np.asarray(demand.exit_share, float)
    ways = []
    for (first, before), begin, per_h in zip(entries, begins, asked, strict=True):
        stay_per_h = per_h
        for (last, after), end, share in zip(exits, ends, shares, strict=True):
            if end - begin < float(road.exit_notice_m):  # who enters nearer does not leave there
                continue
            along, until = tuple(chain[first : last + 1]), end - network.edges[chain[last]].length_m
            ways.append(Way(begin, until, end, before, along, after, stay_per_h * share))
            stay_per_h *= 1.0 - share
        end = float(road.length_m)
        ways.append(Way(begin, end, end, before, tuple(chain[first:]), None, stay_per_h))
    return ways


def world(road: dict[str, Any], factor: float, following: IDM) -> tuple[ChargingEnv, EnvParams]:
    """`corridor` on a road without EVs, its demand by lane, ramp and exit times a factor."""
    usual_env, usual = medjax.make("corridor")
    demand, lane_km = usual.demand, road["length_m"] / 1000.0 * road["num_lanes"]
    by_lane = float(demand.mainline_per_h) / usual_env.config.num_lanes
    return medjax.make(
        "corridor",
        road=road,
        following=following,
        num_gas=round(lane_km * SLOTS_PER_LANE_KM),
        num_evs=1,
        num_meds=1,
        ev_share=0.0,
        profile=[1.0],
        mainline_per_h=factor * by_lane * road["num_lanes"],
        ramp_per_h=[factor * float(demand.ramp_per_h[0])] * len(road["ramp_x_m"]),
        exit_share=[float(demand.exit_share[0])] * len(road["exit_x_m"]),
    )
