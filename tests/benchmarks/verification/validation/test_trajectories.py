"""Neighbours against brute force, accelerations, and rows of slots."""

import numpy as np
import pytest

from benchmarks.verification.validation.medjax_side import trajectories_from_slots
from benchmarks.verification.validation.trajectories import NOBODY, Bodies, neighbours
from tests.benchmarks.verification.validation.made import ROAD, TICK_S, drive, random_traffic, seen


def brute_force(rows, row):
    """The nearest vehicle ahead of a row: (its row, bumper gap)."""
    together = (rows.tick == rows.tick[row]) & (rows.lane == rows.lane[row])
    gaps = np.where(together & (rows.x > rows.x[row]), rows.x - rows.length - rows.x[row], np.inf)
    best = int(gaps.argmin())
    return (best, gaps[best]) if np.isfinite(gaps[best]) else (NOBODY, np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_are_those_of_all_pairs(seed):
    rows = random_traffic(seed)
    found = neighbours(rows)
    ahead, gaps = zip(*(brute_force(rows, row) for row in range(len(rows.x))), strict=True)
    assert found.ahead.tolist() == list(ahead)
    assert found.gap == pytest.approx(gaps)
    assert max(ahead) > NOBODY
    behind = np.full(len(rows.x), NOBODY)
    for row, leader in enumerate(ahead):
        if leader != NOBODY:
            behind[leader] = row
    assert found.behind.tolist() == behind.tolist()


def test_acceleration_is_of_one_vehicle():
    rows = seen(drive([0] * 3, [20.0, 21.0, 20.5]), drive([0] * 2, [3.0, 3.0]))
    assert rows.acceleration() == pytest.approx([np.nan, 4.0, -2.0, np.nan, 0.0], nan_ok=True)


def test_slots_become_vehicles():
    """One slot empties, two are refilled at once (behind, and ahead), and one is filled for good."""
    x = np.array([[10, 3990, 600, 0], [15, 3995, 605, 0], [20, 0, 610, 7], [25, 5, 2500, 9]], float)
    constant = {"speed": 20.0, "lane": 2, "lateral_offset": -0.5}
    slots = {name: np.full(x.shape, value) for name, value in constant.items()}
    slots["active"] = np.array([[1, 1, 1, 0], [1, 1, 1, 0], [0, 1, 1, 1], [1, 1, 1, 1]], bool)
    slots |= {"x": x, "kind": np.array([[0, 1, 1, 1]] * 4)}
    bodies = Bodies(np.array([12.0, 5.0]), np.array([2.5, 1.8]))
    rows = trajectories_from_slots(slots, ROAD, TICK_S, bodies)
    assert rows.vehicle.tolist() == [0, 0, 1, 2, 2, 3, 3, 4, 4, 4, 5, 6, 6]
    assert rows.tick.tolist() == [0, 1, 3, 0, 1, 2, 3, 0, 1, 2, 3, 2, 3]
    assert rows.length[:4].tolist() == [12.0, 12.0, 12.0, 5.0]
    assert rows.width[:4].tolist() == [2.5, 2.5, 2.5, 1.8]
    assert set(rows.lateral) == {7.5}
