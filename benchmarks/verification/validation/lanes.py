"""Changes of lanes on the main road, what becomes of them, and how fast vehicles move sideways."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.verification.validation.trajectories import Trajectories

UNDONE_S = 6.0  # a change that is taken back within this was none


@dataclasses.dataclass(frozen=True)
class LaneChanges:
    """Changes between lanes of the main road; merges are not among them."""

    changes: int
    undone: int  # changed back within UNDONE_S
    vehicle_km: float  # on the main road
    lateral_acceleration: (
        np.ndarray
    )  # (V,) m/s2, the largest of each vehicle; empty where nothing is known


def lane_changes(seen: Trajectories) -> LaneChanges:
    """All of them."""
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
    """Largest of each vehicle seen for three ticks, m/s2: second differences of where it is across the road."""
    if seen.lateral is None:
        return np.zeros(0)
    second = np.abs(np.diff(seen.lateral, 2)) / seen.tick_s**2
    same = seen.goes_on[1:] & seen.goes_on[:-1]
    largest = np.full(seen.vehicle.max(initial=0) + 1, -1.0)
    np.maximum.at(largest, seen.vehicle[2:][same], second[same])
    return largest[largest >= 0.0]
