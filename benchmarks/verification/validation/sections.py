"""Flow, density and speed at detectors, and how they change when traffic breaks down."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.verification.validation.trajectories import Road, Trajectories

SECTION_M = 100.0  # length of road that a detector covers
# Speed below which traffic has broken down, as a share of the free speed: 18 of 30 m/s. The criterion of the HCM
# (Highway Capacity Manual), 25 % less over 15 minutes, would not do: IDM drives that slowly at capacity. German
# practice is 70 km/h (Brilon, Geistefeldt, Regler 2005, from memory).
BREAKDOWN_SPEED_SHARE = 0.6
FLOW_MINUTES = 5  # averaging interval of flows


def detectors(road: Road) -> list[float]:
    """Middles of the sections, m: before each acceleration lane, half-way between two, and behind the last one.

    The last section measures the discharge. Sections overlap neither acceleration lanes nor the road's ends.
    """
    half = 0.5 * SECTION_M
    places, free_from = [], 0.0
    for ramp in (*road.ramp_x_m, road.length_m):
        if ramp - free_from >= 2.0 * SECTION_M:
            middle = 0.5 * (free_from + ramp)
            before = [ramp - half] if ramp < road.length_m and ramp - middle > SECTION_M else []
            places += [middle, *before]
        free_from = ramp + road.acceleration_lane_m
    return places


@dataclasses.dataclass(frozen=True)
class FundamentalDiagram:
    """The fundamental diagram: flow and density at D detectors by minute."""

    x_m: np.ndarray  # (D,)
    flow: np.ndarray  # (minutes, D, num_lanes) vehicles/h
    density: np.ndarray  # (minutes, D, num_lanes) vehicles/km

    def flow_per_lane(self) -> np.ndarray:
        """Mean over lanes, (minutes, D) vehicles/h/lane."""
        return self.flow.mean(axis=-1)

    def speed(self) -> np.ndarray:
        """Space-mean speed over all lanes, (minutes, D) m/s; NaN where there were no vehicles."""
        flow, density = self.flow.sum(axis=-1), self.density.sum(axis=-1)
        return np.where(density > 0.0, flow / np.maximum(density, 1e-9), np.nan) / 3.6


def fundamental_diagram(seen: Trajectories) -> FundamentalDiagram:
    """Measures flow and density by Edie's definitions (1963), in a section of a lane over a minute.

    Flow is the distance that vehicles travel there, and density the time that they spend there, each divided by the
    area: the section's length times the minute. Flow divided by density is then the space-mean speed, also where
    vehicles stand.
    """
    x_m, lanes = np.array(detectors(seen.road)), seen.road.num_lanes
    minutes = int(seen.span_s // 60.0)
    minute = (seen.tick * seen.tick_s // 60.0).astype(np.int64)
    flow, density = np.zeros((2, minutes, len(x_m), lanes))
    for index, middle in enumerate(x_m):
        offset = seen.x - middle
        there = (offset >= -0.5 * SECTION_M) & (offset < 0.5 * SECTION_M)
        rows = np.nonzero(there & (seen.lane < lanes) & (minute < minutes))[0]
        cell, count = minute[rows] * lanes + seen.lane[rows], minutes * lanes
        ticks = np.bincount(cell, minlength=count).reshape(minutes, lanes)
        speeds = np.bincount(cell, seen.speed[rows], count).reshape(minutes, lanes)
        share = seen.tick_s / 60.0 / SECTION_M  # tick as a share of a minute, per metre
        density[:, index], flow[:, index] = 1e3 * share * ticks, 3600.0 * share * speeds
    return FundamentalDiagram(x_m, flow, density)


@dataclasses.dataclass(frozen=True)
class Breakdown:
    """The bottleneck that breaks down first, and its flows in vehicles/h/lane; NaN if there is none."""

    minute: int | None  # the first minute of the breakdown; None if there was none
    x_m: float  # place of the detector that saw it; the flows below are those at the next detector
    highest_before: float  # highest 5-minute flow before the breakdown
    # Both means leave out the first 5 minutes of the breakdown.
    # Mean flow while the bottleneck is active: a queue at the detector, none at the next.
    after: float
    discharge: float  # mean flow at the last detector while there is a queue anywhere before it

    @property
    def capacity_drop(self) -> float:
        """Share of the flow that is lost after the breakdown."""
        return 1.0 - self.after / self.highest_before


def mean(values: np.ndarray) -> float:
    """Mean of the finite values; NaN if there are none."""
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else np.nan


def _means(values: np.ndarray) -> np.ndarray:
    """Moving means over FLOW_MINUTES, (minutes - 4,); empty if there are fewer minutes."""
    window = np.full(FLOW_MINUTES, 1.0 / FLOW_MINUTES)
    return np.convolve(values, window, mode="valid") if len(values) >= FLOW_MINUTES else np.zeros(0)


def breakdown(diagram: FundamentalDiagram, free_speed: float) -> Breakdown:
    """Finds where and when traffic breaks down first, and the flow that the road then carries.

    A section has broken down when its speed stays below BREAKDOWN_SPEED_SHARE of `free_speed` (m/s) for FLOW_MINUTES. A
    bottleneck is active while the queue ends between two detectors (Cassidy and Bertini 1999: no influence from
    downstream).
    """
    flow, slow = diagram.flow_per_lane(), diagram.speed() < BREAKDOWN_SPEED_SHARE * free_speed
    stays = np.array([_means(column) for column in slow[:, :-1].T.astype(float)]) > 1.0 - 1e-9
    begins = np.nonzero(stays.any(axis=0))[0]
    if not len(begins):
        return Breakdown(None, np.nan, np.nan, np.nan, np.nan)
    minute = int(begins[0])
    # The bottleneck is at the most downstream of these sections, since queues grow upstream.
    index = int(np.nonzero(stays[:, minute])[0][-1])
    late = np.arange(len(flow)) >= minute + FLOW_MINUTES
    active = late & slow[:, index] & ~slow[:, index + 1]
    queue = late & slow[:, :-1].any(axis=1)
    return Breakdown(
        minute=minute,
        x_m=float(diagram.x_m[index]),
        highest_before=float(max(_means(flow[:minute, index + 1]), default=np.nan)),
        after=mean(flow[active, index + 1]),
        discharge=mean(flow[queue, -1]),
    )
