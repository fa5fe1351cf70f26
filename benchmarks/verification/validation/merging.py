"""How vehicles get from acceleration lanes onto the main road, and what that costs those already there."""

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

ANSWER_S = 5.0  # a new follower's answer to a merge is looked for as long
NEAR_M = 100.0  # a follower further behind is none


@dataclasses.dataclass(frozen=True)
class Merges:
    """K changes from an acceleration lane to the right lane, and U vehicles seen on acceleration lanes."""

    speed: np.ndarray  # (K,) m/s, at the first tick on the right lane
    relative_speed: (
        np.ndarray
    )  # (K,) by the right lane's mean beside the acceleration lane, that minute
    share_used: np.ndarray  # (K,) of the acceleration lane, before it was left
    accepted_gap_s: (
        np.ndarray
    )  # (K,) rear of the new leader to front of the new follower, by the latter's speed
    follower_acceleration: np.ndarray  # (K,) m/s2, the new follower's least within ANSWER_S
    standing_s: np.ndarray  # (U,) s that each stood on the acceleration lane


def merges(seen: Trajectories, beside: Neighbours) -> Merges:
    """All merges; NaN where there is nobody to compare with."""
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
    """Number of the ramp whose acceleration lane x is on or behind, `x.shape` int."""
    return np.maximum(np.searchsorted(road.ramp_x_m, x, side="right") - 1, 0)


def _minute(seen: Trajectories) -> np.ndarray:
    """Of each row, (R,) int."""
    minute: np.ndarray = (seen.tick * seen.tick_s // 60.0).astype(np.int64)
    return minute


def _right_lane_speed(seen: Trajectories) -> np.ndarray:
    """Mean beside each acceleration lane, (minutes, ramps) m/s, of those who did not come from there; NaN: nobody."""
    road = seen.road
    ramp = _ramp_at(road, seen.x)
    start = np.asarray(road.ramp_x_m)[ramp]
    came_from = np.full(seen.vehicle.max(initial=0) + 1, NOBODY)
    rows = np.nonzero(seen.on_ramp)[0]
    # A vehicle on an acceleration lane is nearer to its start than to any other ramp's, also just before it.
    middle = seen.x[rows] - 0.5 * road.acceleration_lane_m
    distance = np.abs(np.asarray(road.ramp_x_m)[:, None] - middle)
    came_from[seen.vehicle[rows]] = distance.argmin(axis=0)
    there = (seen.lane == road.num_lanes - 1) & (seen.x >= start)
    there &= (seen.x <= start + road.acceleration_lane_m) & (came_from[seen.vehicle] != ramp)
    minutes, ramps = int(seen.span_s // 60.0) + 1, len(road.ramp_x_m)
    cell = _minute(seen)[there] * ramps + ramp[there]
    count = np.bincount(cell, minlength=minutes * ramps)
    total = np.bincount(cell, seen.speed[there], minutes * ramps)
    mean: np.ndarray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean.reshape(minutes, ramps)


def _least_acceleration(seen: Trajectories, row: np.ndarray) -> np.ndarray:
    """Within ANSWER_S after these rows, of the same vehicle, `row.shape` m/s2; NaN where it is not seen again."""
    ticks = np.arange(1, round(ANSWER_S / seen.tick_s) + 1)
    later = np.minimum(row[:, None] + ticks, len(seen.x) - 1)
    same = (seen.vehicle[later] == seen.vehicle[row][:, None]) & (later > row[:, None])
    least = np.where(same, seen.acceleration()[later], np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


def _standing(seen: Trajectories) -> np.ndarray:
    """Seconds that each vehicle stood on an acceleration lane, of all that were on one."""
    rows = np.nonzero(seen.on_ramp)[0]
    _, who = np.unique(seen.vehicle[rows], return_inverse=True)
    return np.bincount(who, seen.speed[rows] < STANDING) * seen.tick_s
