"""All measurements of trajectories, and their summary over many episodes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.verification.boxes import overlapping
from benchmarks.verification.validation.merging import Merges, merges
from benchmarks.verification.validation.sections import (
    FLOW_MINUTES,
    Breakdown,
    FundamentalDiagram,
    breakdown,
    fundamental_diagram,
    mean,
)
from benchmarks.verification.validation.trajectories import STANDING, Trajectories, neighbours

FREE_AHEAD_M = 60.0  # a vehicle with this much room ahead has no reason to stand
OVERLAP_M = 0.02  # a smaller overlap is rounding
UNDONE_S = 6.0  # a vehicle that changes back within this time undoes its change
ENDS_M = 40.0  # a vehicle drove the whole road if it was first and last seen this near to its ends


@dataclasses.dataclass(frozen=True)
class LaneChanges:
    """Changes between lanes of the main road, without merges."""

    changes: int
    undone: int  # changed back within UNDONE_S
    vehicle_km: float  # on the main road
    lateral_acceleration: np.ndarray  # (V,) m/s2, each vehicle's largest; empty if unknown


@dataclasses.dataclass(frozen=True)
class Findings:
    """Measurements of one episode."""

    span_s: float
    entered_main: int
    entered_ramps: int
    left: int
    vehicles_max: int  # on the road at once
    diagram: FundamentalDiagram
    broke_down: Breakdown
    merged: Merges
    changed: LaneChanges
    travel_s: np.ndarray  # (V,) s, of vehicles that drove the whole main road
    idle_s: float  # vehicle-seconds of standing on the main road with FREE_AHEAD_M free ahead
    standing_s: float  # vehicle-seconds of standing on the main road
    collisions: int  # vehicles that overlap the one ahead in their lane, summed over ticks
    in_one_place: int  # pairs of overlapping bodies in any lanes, counted once per second


def find(seen: Trajectories, free_speed: float) -> Findings:
    """Measures one episode after its warm-up; `free_speed` is the speed of free traffic, m/s."""
    beside = neighbours(seen)
    diagram = fundamental_diagram(seen)
    ends, rows = ~seen.goes_on, len(seen.x)
    first, last = (np.flatnonzero(each[:rows]) for each in (np.r_[True, ends], np.r_[ends, True]))
    came = first[seen.tick[first] > 0]
    stands = ~seen.on_ramp & (seen.speed < STANDING)
    return Findings(
        span_s=seen.span_s,
        entered_main=int((~seen.on_ramp[came]).sum()),
        entered_ramps=int(seen.on_ramp[came].sum()),
        left=int((seen.tick[last] < seen.num_ticks - 1).sum()),
        vehicles_max=int(np.bincount(seen.tick, minlength=1).max()),
        diagram=diagram,
        broke_down=breakdown(diagram, free_speed),
        merged=merges(seen, beside),
        changed=lane_changes(seen),
        travel_s=_travel_times(seen, first, last),
        idle_s=float((stands & (beside.gap >= FREE_AHEAD_M)).sum() * seen.tick_s),
        standing_s=float(stands.sum() * seen.tick_s),
        collisions=int((beside.gap < -OVERLAP_M).sum()),
        in_one_place=_in_one_place(seen),
    )


def _travel_times(seen: Trajectories, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Travel time over the main road's length, s, of each vehicle that drove all of it under observation."""
    whole = (seen.tick[first] > 0) & (seen.x[first] <= ENDS_M) & ~seen.on_ramp[first]
    whole &= seen.x[last] >= seen.road.length_m - ENDS_M
    first, last = first[whole], last[whole]
    pace = (seen.tick[last] - seen.tick[first]) * seen.tick_s / (seen.x[last] - seen.x[first])
    return pace * seen.road.length_m


def lane_changes(seen: Trajectories) -> LaneChanges:
    """Measures all lane changes on the main road."""
    main = ~seen.on_ramp
    both = seen.goes_on & main[1:] & main[:-1]
    step = np.where(both, np.diff(seen.lane), 0)
    row = 1 + np.nonzero(step)[0]
    back = seen.vehicle[row][1:] == seen.vehicle[row][:-1]
    back &= seen.lane[row][1:] == seen.lane[row - 1][:-1]
    back &= (seen.tick[row][1:] - seen.tick[row][:-1]) * seen.tick_s <= UNDONE_S
    return LaneChanges(
        changes=len(row),
        undone=int(back.sum()),
        vehicle_km=float(np.where(both, np.diff(seen.x), 0.0).sum()) / 1e3,
        lateral_acceleration=_lateral_acceleration(seen),
    )


def _lateral_acceleration(seen: Trajectories) -> np.ndarray:
    """Largest lateral acceleration of each vehicle, m/s2, from second differences of its lateral position.

    It needs at least three ticks of a vehicle.
    """
    if seen.lateral is None:
        return np.zeros(0)
    second = np.abs(np.diff(seen.lateral, 2)) / seen.tick_s**2
    same = seen.goes_on[1:] & seen.goes_on[:-1]
    largest = np.full(seen.vehicle.max(initial=0) + 1, -1.0)
    np.maximum.at(largest, seen.vehicle[2:][same], second[same])
    return largest[largest >= 0.0]


def _in_one_place(seen: Trajectories) -> int:
    """Pairs that `boxes.overlapping` finds among all bodies, counted once per second.

    SUMO's vehicles jump from lane to lane, so they count as centred in a lane.
    """
    lateral = seen.lane * seen.road.lane_width_m if seen.lateral is None else seen.lateral
    order = np.argsort(seen.tick, kind="stable")
    ticks = np.arange(seen.num_ticks + 1)
    bounds = np.searchsorted(seen.tick[order], ticks)
    pairs = 0
    for tick in range(0, seen.num_ticks, max(round(1.0 / seen.tick_s), 1)):
        rows = order[bounds[tick] : bounds[tick + 1]]
        sizes = seen.length[rows], seen.width[rows]
        there = np.ones(len(rows), bool)
        pairs += int(np.sum(overlapping(seen.x[rows], lateral[rows], *sizes, there)))
    return pairs


def percentile(values: np.ndarray, percent: float) -> float:
    """Percentile of the finite values; NaN if there are none."""
    values = values[np.isfinite(values)]
    return float(np.percentile(values, percent)) if len(values) else np.nan


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole else np.nan


def summarise(findings: Sequence[Findings]) -> dict[str, Any]:
    """Figures of several episodes together, as floats by name; NaN if there was nothing to measure.

    Means and percentiles are over the pooled vehicles, merges or minutes of all episodes.
    """
    hours = sum(found.span_s for found in findings) / 3600.0
    travel = np.concatenate([found.travel_s for found in findings])

    def total(*names: str) -> dict[str, Any]:
        return {name: sum(getattr(found, name) for found in findings) for name in names}

    def hourly(*names: str) -> dict[str, Any]:
        return {f"{name}_per_h": count / hours for name, count in total(*names).items()}

    return {
        "episodes": len(findings),
        "minutes": hours * 60.0 / len(findings),
        **hourly("entered_main", "entered_ramps", "left"),
        "vehicles_max": max(found.vehicles_max for found in findings),
        **_of_merges([found.merged for found in findings]),
        **_of_lanes([found.changed for found in findings]),
        "travel_mean_s": mean(travel),
        "travel_p95_s": percentile(travel, 95),
        **hourly("standing_s", "idle_s"),
        **total("collisions", "in_one_place"),
        **_of_flow(findings),
    }


# Student's t at 95 %, by degrees of freedom from 1. The last value serves for all higher degrees, too: intervals then
# are less than 9 % too wide.
STUDENT_T = (
    12.71, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
)  # fmt: skip


def half_width(values: Sequence[float]) -> float:
    """Half-width of a mean's 95 % interval, by Student's t; NaN for a single value."""
    count = len(values)
    if count < 2:
        return math.nan
    scale = STUDENT_T[min(count - 1, len(STUDENT_T)) - 1] / math.sqrt(count)
    return scale * float(np.std(values, ddof=1))


def half_widths(findings: Sequence[Findings]) -> dict[str, float]:
    """Half-width of each figure's 95 % interval over episodes."""
    each = [summarise([found]) for found in findings]
    return {name: half_width([figures[name] for figures in each]) for name in each[0]}


def _of_merges(merged: Sequence[Merges]) -> dict[str, Any]:
    def of(name: str) -> np.ndarray:
        return np.concatenate([getattr(each, name) for each in merged])

    speed, relative, standing = of("speed"), of("relative_speed"), of("standing_s")
    return {
        "merges": len(speed),
        "ramp_vehicles": len(standing),
        "ramp_stop_share": _share((standing > 0.0).sum(), len(standing)),
        "ramp_standing_mean_s": _share(standing.sum(), len(standing)),
        "ramp_standing_max_s": float(standing.max(initial=0.0)),
        "merge_speed_median": percentile(speed, 50),
        "merge_speed_p5": percentile(speed, 5),
        "merge_relative_speed_median": percentile(relative, 50),
        "merge_relative_speed_p5": percentile(relative, 5),
        "merge_lane_used_median": percentile(of("share_used"), 50),
        "merge_accepted_gap_median_s": percentile(of("accepted_gap_s"), 50),
        "merge_accepted_gap_min_s": percentile(of("accepted_gap_s"), 0),
        "follower_acceleration_p5": percentile(of("follower_acceleration"), 5),
        "follower_acceleration_min": percentile(of("follower_acceleration"), 0),
    }


def _of_lanes(changed: Sequence[LaneChanges]) -> dict[str, Any]:
    changes = sum(each.changes for each in changed)
    lateral = np.concatenate([each.lateral_acceleration for each in changed])
    return {
        "lane_changes_per_km": _share(changes, sum(each.vehicle_km for each in changed)),
        "undone_share": _share(sum(each.undone for each in changed), changes),
        "lateral_acceleration_p99": percentile(lateral, 99),
        "lateral_acceleration_max": percentile(lateral, 100),
    }


def _of_flow(findings: Sequence[Findings]) -> dict[str, Any]:
    last = np.concatenate([found.diagram.flow_per_lane()[:, -1] for found in findings])
    speed = np.concatenate([found.diagram.speed()[:, -1] for found in findings])
    broke = [found.broke_down for found in findings if found.broke_down.minute is not None]

    def of_breakdowns(name: str) -> float:
        return mean(np.array([getattr(each, name) for each in broke]))

    best, density = max(_five_minutes(found.diagram) for found in findings)
    return {
        "flow_last_mean": mean(last),
        "speed_last_mean": mean(speed),
        "flow_max": best,
        "density_at_flow_max": density,
        "breakdown_share": len(broke) / len(findings),
        "breakdown_x_m": of_breakdowns("x_m"),
        "flow_before_breakdown": of_breakdowns("highest_before"),
        "flow_after_breakdown": of_breakdowns("after"),
        "discharge": of_breakdowns("discharge"),
        "capacity_drop": of_breakdowns("capacity_drop"),
    }


def _five_minutes(diagram: FundamentalDiagram) -> tuple[float, float]:
    """Highest 5-minute flow behind the last ramp, vehicles/h/lane, and the density then, vehicles/km/lane."""
    flow, density = diagram.flow.mean(axis=-1)[:, -1], diagram.density.mean(axis=-1)[:, -1]
    spans = [slice(at, at + FLOW_MINUTES) for at in range(max(1, len(flow) - FLOW_MINUTES + 1))]
    return max((float(flow[span].mean()), float(density[span].mean())) for span in spans)
