"""Lane changes on the main road, how many are undone, and lateral accelerations."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.verification.validation.trajectories import Trajectories

UNDONE_S = 6.0  # a change that is reversed within this time counts as undone


@dataclasses.dataclass(frozen=True)
class LaneChanges:
    """Changes between lanes of the main road, without merges."""

    changes: int
    undone: int  # changed back within UNDONE_S
    vehicle_km: float  # on the main road
    lateral_acceleration: np.ndarray  # (V,) m/s2, each vehicle's largest; empty if unknown


def lane_changes(seen: Trajectories) -> LaneChanges:
    """Counts all lane changes."""
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
    """Largest of each vehicle seen for at least three ticks, m/s2, by second differences of its lateral position."""
    if seen.lateral is None:
        return np.zeros(0)
    second = np.abs(np.diff(seen.lateral, 2)) / seen.tick_s**2
    same = seen.goes_on[1:] & seen.goes_on[:-1]
    largest = np.full(seen.vehicle.max(initial=0) + 1, -1.0)
    np.maximum.at(largest, seen.vehicle[2:][same], second[same])
    return largest[largest >= 0.0]
