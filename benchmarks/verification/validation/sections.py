"""Flow, density and speed at places of the road, and what becomes of them when it breaks down."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.verification.validation.trajectories import Road, Trajectories

SECTION_M = 100.0  # of road that a detector looks at
BREAKDOWN = 0.75  # of the free speed; HCM 7th ed.: a breakdown is a drop of 25 % at least, here over 5 minutes
FLOW_MINUTES = 5  # minutes that a flow is the mean of


def detectors(road: Road) -> list[float]:
    """Middles of the sections: before each acceleration lane, half way between two, and behind the last.

    The last one is where discharge is counted. Sections neither overlap an acceleration lane nor the road's ends.
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
class Diagram:
    """What detectors counted in each minute, D detectors."""

    x_m: np.ndarray  # (D,)
    flow: np.ndarray  # (minutes, D, num_lanes) vehicles/h
    density: np.ndarray  # (minutes, D, num_lanes) vehicles/km

    def flow_a_lane(self) -> np.ndarray:
        """Mean over lanes, (minutes, D) vehicles/h/lane."""
        mean: np.ndarray = self.flow.mean(axis=-1)
        return mean

    def speed(self) -> np.ndarray:
        """Of all lanes together, (minutes, D) m/s: of vehicles in space; NaN where nobody was."""
        flow, density = self.flow.sum(axis=-1), self.density.sum(axis=-1)
        return np.where(density > 0.0, flow / np.maximum(density, 1e-9), np.nan) / 3.6


def diagram(seen: Trajectories) -> Diagram:
    """By Edie's definitions (1963): time and way spent on a section of a lane in a minute, by its area.

    Speed in space is then flow by density, also where vehicles stand.
    """
    x_m, lanes = np.array(detectors(seen.road)), seen.road.num_lanes
    minutes = int(seen.span_s // 60.0)
    minute = (seen.tick * seen.tick_s // 60.0).astype(np.int64)
    flow, density = np.zeros((2, minutes, len(x_m), lanes))
    for place, middle in enumerate(x_m):
        offset = seen.x - middle
        there = (offset >= -0.5 * SECTION_M) & (offset < 0.5 * SECTION_M)
        rows = np.nonzero(there & (seen.lane < lanes) & (minute < minutes))[0]
        cell, count = minute[rows] * lanes + seen.lane[rows], minutes * lanes
        ticks = np.bincount(cell, minlength=count).reshape(minutes, lanes)
        speeds = np.bincount(cell, seen.speed[rows], count).reshape(minutes, lanes)
        share = (
            seen.tick_s / 60.0 / SECTION_M
        )  # of the section's minute that a vehicle's tick takes
        density[:, place], flow[:, place] = 1e3 * share * ticks, 3600.0 * share * speeds
    return Diagram(x_m, flow, density)


@dataclasses.dataclass(frozen=True)
class Breakdown:
    """A bottleneck before and after it breaks down; flows are of the last detector, behind the last ramp."""

    minute: int | None  # the first one of the breakdown; None: it never came
    highest_before: float  # vehicles/h/lane, over 5 minutes before it (of all, if it never came); 0: it came sooner
    discharge: (
        float  # vehicles/h/lane, mean from 5 minutes after it on while the queue stands; NaN: none
    )

    @property
    def capacity_drop(self) -> float:
        """Share of the flow that is lost; NaN: no breakdown."""
        return 1.0 - self.discharge / self.highest_before if self.highest_before else np.nan


def _means(values: np.ndarray) -> np.ndarray:
    """Of FLOW_MINUTES at a time, (minutes - 4,); none if it was shorter."""
    if len(values) < FLOW_MINUTES:
        return np.zeros(0)
    return np.convolve(values, np.full(FLOW_MINUTES, 1.0 / FLOW_MINUTES), mode="valid")


def breakdown(counted: Diagram, free_speed: float) -> Breakdown:
    """When traffic breaks down anywhere but behind the last ramp, and what the road then carries.

    Broken down is a section whose speed stays below BREAKDOWN of `free_speed` (m/s) for FLOW_MINUTES.
    """
    slow = counted.speed()[:, :-1] < BREAKDOWN * free_speed
    queue = slow.any(axis=1)
    discharge = counted.flow_a_lane()[:, -1]
    stays = np.array([_means(column) for column in slow.T.astype(float)]) > 1.0 - 1e-9
    begins = np.nonzero(stays.any(axis=0))[0]
    before = int(begins[0]) if len(begins) else len(discharge)
    highest = float(_means(discharge[:before]).max(initial=0.0))
    if not len(begins):
        return Breakdown(None, highest, np.nan)
    late = np.arange(len(discharge)) >= before + FLOW_MINUTES
    standing = discharge[late & queue]
    mean = float(standing.mean()) if len(standing) else np.nan
    return Breakdown(before, highest, mean)
