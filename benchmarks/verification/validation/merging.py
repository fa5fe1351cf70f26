"""How vehicles merge from acceleration lanes, and how that affects vehicles on the main road."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.verification.validation.trajectories import (
    NOBODY,
    STANDING,
    Neighbours,
    Road,
    Trajectories,
)

ANSWER_S = 5.0  # time in which a new follower reacts to a merge
NEAR_M = 100.0  # largest gap to the new follower at which its reaction counts


@dataclasses.dataclass(frozen=True)
class Merges:
    """K changes from an acceleration lane to the right lane, and U vehicles seen on acceleration lanes."""

    speed: np.ndarray  # (K,) m/s, at the first tick on the right lane
    # (K,) speed divided by that minute's mean speed in the right lane beside the acceleration lane
    relative_speed: np.ndarray
    share_used: np.ndarray  # (K,) share of the acceleration lane used before the merge
    # (K,) distance from the new leader's rear to the new follower's front, divided by the follower's speed
    accepted_gap_s: np.ndarray
    follower_acceleration: np.ndarray  # (K,) m/s2, the new follower's minimum within ANSWER_S
    standing_s: np.ndarray  # (U,) s, standing time on the acceleration lane


def merges(seen: Trajectories, beside: Neighbours) -> Merges:
    """Measures all merges; NaN where there is no vehicle to compare with."""
    onto = seen.road.num_lanes - 1
    left = seen.goes_on & seen.on_ramp[:-1] & (seen.lane[1:] == onto)
    row = 1 + np.nonzero(left)[0]
    ramp = _ramp_at(seen.road, seen.x[row])
    start = np.asarray(seen.road.ramp_x_m)[ramp]
    mean = _right_lane_speed(seen)[_minute(seen)[row], ramp]
    ahead, behind = beside.ahead[row], beside.behind[row]
    follower_speed = np.maximum(seen.speed[behind], STANDING)
    accepted = (seen.x[ahead] - seen.length[ahead] - seen.x[behind]) / follower_speed
    follows = (behind != NOBODY) & (beside.gap[behind] <= NEAR_M)
    least = _least_acceleration(seen, np.where(follows, behind, 0))
    return Merges(
        speed=seen.speed[row],
        relative_speed=seen.speed[row] / mean,
        share_used=(seen.x[row] - start) / seen.road.acceleration_lane_m,
        accepted_gap_s=np.where((ahead != NOBODY) & (behind != NOBODY), accepted, np.nan),
        follower_acceleration=np.where(follows, least, np.nan),
        standing_s=_standing(seen),
    )


def _ramp_at(road: Road, x: np.ndarray) -> np.ndarray:
    """Number of the last ramp at or before x, `x.shape` int."""
    return np.maximum(np.searchsorted(road.ramp_x_m, x, side="right") - 1, 0)


def _minute(seen: Trajectories) -> np.ndarray:
    """Minute of each row, (R,) int."""
    return (seen.tick * seen.tick_s // 60.0).astype(np.int64)


def _right_lane_speed(seen: Trajectories) -> np.ndarray:
    """Mean speed in the right lane beside each acceleration lane, (minutes, ramps) m/s.

    It leaves out vehicles from that ramp, and is NaN without any others.
    """
    road = seen.road
    ramp = _ramp_at(road, seen.x)
    start = np.asarray(road.ramp_x_m)[ramp]
    came_from = np.full(seen.vehicle.max(initial=0) + 1, NOBODY)
    rows = np.nonzero(seen.on_ramp)[0]
    # The nearest acceleration lane also identifies the ramp of a vehicle that is just before its start.
    middle = seen.x[rows] - 0.5 * road.acceleration_lane_m
    distance = np.abs(np.asarray(road.ramp_x_m)[:, None] - middle)
    came_from[seen.vehicle[rows]] = distance.argmin(axis=0)
    there = (seen.lane == road.num_lanes - 1) & (seen.x >= start)
    there &= (seen.x <= start + road.acceleration_lane_m) & (came_from[seen.vehicle] != ramp)
    minutes, ramps = int(seen.span_s // 60.0) + 1, len(road.ramp_x_m)
    cell = _minute(seen)[there] * ramps + ramp[there]
    count = np.bincount(cell, minlength=minutes * ramps)
    total = np.bincount(cell, seen.speed[there], minutes * ramps)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(minutes, ramps)


def _least_acceleration(seen: Trajectories, row: np.ndarray) -> np.ndarray:
    """Lowest acceleration of a row's vehicle in the next ANSWER_S, `row.shape` m/s2; NaN if it has no later row."""
    ticks = np.arange(1, round(ANSWER_S / seen.tick_s) + 1)
    later = np.minimum(row[:, None] + ticks, len(seen.x) - 1)
    same = (seen.vehicle[later] == seen.vehicle[row][:, None]) & (later > row[:, None])
    least = np.where(same, seen.acceleration()[later], np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


def _standing(seen: Trajectories) -> np.ndarray:
    """Standing time of each vehicle that was on an acceleration lane, s."""
    rows = np.nonzero(seen.on_ramp)[0]
    _, who = np.unique(seen.vehicle[rows], return_inverse=True)
    return np.bincount(who, seen.speed[rows] < STANDING) * seen.tick_s
