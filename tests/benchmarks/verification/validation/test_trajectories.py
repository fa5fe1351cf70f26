"""Neighbours by brute force, and what a cut and a slot's rows come to."""

import numpy as np
import pytest

from benchmarks.verification.validation.medjax_side import of_slots
from benchmarks.verification.validation.trajectories import NOBODY, neighbours
from tests.benchmarks.verification.validation.made import ROAD, TICK_S, drive, random_traffic, seen


def brute_force(rows, row):
    """The nearest one ahead of a row: (its row, bumper gap)."""
    best = NOBODY, np.inf
    for other in range(len(rows.x)):
        together = rows.tick[other] == rows.tick[row] and rows.lane[other] == rows.lane[row]
        gap = rows.x[other] - rows.length[other] - rows.x[row]
        if together and rows.x[other] > rows.x[row] and gap < best[1]:
            best = other, gap
    return best


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_are_those_of_all_pairs(seed):
    rows = random_traffic(seed)
    found = neighbours(rows)
    expected = [brute_force(rows, row) for row in range(len(rows.x))]
    assert found.ahead.tolist() == [ahead for ahead, _ in expected]
    assert found.gap == pytest.approx([gap for _, gap in expected])
    assert max(found.ahead) > NOBODY
    pairs = {(row, ahead) for row, ahead in enumerate(found.ahead) if ahead != NOBODY}
    assert pairs == {(behind, row) for row, behind in enumerate(found.behind) if behind != NOBODY}


def test_a_cut_begins_at_tick_0():
    rows = seen(drive([0] * 8, 20.0), drive([1] * 4, 10.0), num_ticks=12).after(1.5)
    assert rows.num_ticks == 6
    assert rows.tick.tolist() == [0, 1]
    assert rows.vehicle.tolist() == [0, 0]
    assert rows.x.tolist() == [30.0, 35.0]


def test_acceleration_is_of_one_vehicle():
    rows = seen(drive([0] * 3, [20.0, 21.0, 20.5]), drive([0] * 2, [3.0, 3.0]))
    assert rows.acceleration() == pytest.approx([np.nan, 4.0, -2.0, np.nan, 0.0], nan_ok=True)


def test_slots_become_vehicles():
    """A slot that empties, one filled anew at once, ahead or behind, and one that nobody leaves."""
    x = np.array(
        [
            [10.0, 3990.0, 600.0, 0.0],
            [15.0, 3995.0, 605.0, 0.0],
            [20.0, 0.0, 610.0, 7.0],
            [25.0, 5.0, 2500.0, 9.0],
        ]
    )
    active = np.array([[1, 1, 1, 0], [1, 1, 1, 0], [0, 1, 1, 1], [1, 1, 1, 1]], bool)
    slots = {
        "x": x,
        "speed": np.full(x.shape, 20.0),
        "lane": np.full(x.shape, 2),
        "lateral_offset": np.full(x.shape, -0.5),
        "active": active,
        "kind": np.array([[0, 1, 1, 1]] * 4),
    }
    rows = of_slots(slots, ROAD, TICK_S, np.array([12.0, 5.0]))
    assert rows.vehicle.tolist() == [0, 0, 1, 2, 2, 3, 3, 4, 4, 4, 5, 6, 6]
    assert rows.tick.tolist() == [0, 1, 3, 0, 1, 2, 3, 0, 1, 2, 3, 2, 3]
    assert rows.length[:4].tolist() == [12.0, 12.0, 12.0, 5.0]
    assert set(rows.lateral) == {7.5}
