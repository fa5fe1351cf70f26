"""Neighbours against a search over all pairs, on random roads with ties and empty lanes."""

import functools
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic import find_neighbours, sort_by_road
from medjax.traffic.neighbours import NOBODY
from medjax.traffic.road import NO_LANE
from tests.traffic.reference import brute_force

SLOTS, LANES, LENGTH_M = 24, 5, 4000.0


@functools.partial(jax.jit, static_argnames="backend")
def found(x, lane, target, active, previous, other=None, backend="cpu"):
    """The package's neighbours and order; nobody straddles a line where no other lanes are given."""
    with mock.patch.object(jax, "default_backend", return_value=backend):
        order = sort_by_road(x, active, LENGTH_M, previous)
        other = jnp.full_like(lane, NO_LANE) if other is None else other
        return find_neighbours(order, lane, other, target, active, LANES), order


def compared(x, lane, direction, active, previous=None, straddles=0, backend="cpu"):
    """All four neighbours of every slot, by the package and by brute force.

    A vehicle that `straddles`, -1 or 1, looks at its other lane.
    """
    x, lane = np.asarray(x, np.float32), np.asarray(lane, np.int32)
    active, straddles = np.asarray(active), np.broadcast_to(straddles, lane.shape)
    other = np.where(straddles == 0, NO_LANE, lane + straddles).astype(np.int32)
    target = (lane + np.where(straddles == 0, direction, straddles)).astype(np.int32)
    previous = np.arange(len(x)) if previous is None else previous
    previous = jnp.asarray(previous, jnp.int32)
    got, order = found(x, lane, target, active, previous, other, backend)
    is_there = (target >= 0) & (target < LANES)
    there = np.where(is_there, target, 99)
    expected = (
        *brute_force(x, lane, lane, other, active),
        *brute_force(x, lane, there, other, active),
    )
    # A straddling vehicle finds itself behind itself in the other lane.
    own = active & (straddles != 0) & is_there
    expected[3][own] = np.flatnonzero(own)
    assert sorted(np.asarray(order)) == list(range(len(x)))
    return got, np.array(expected)


def assert_neighbours(*road, **options):
    """Asserts that the package's neighbours are those of brute force, and returns them."""
    got, expected = compared(*road, **options)
    np.testing.assert_array_equal(np.array(got), expected, "leader, follower; in the target lane")
    return got


# A CPU counts and a GPU reads bit sets; both must find the same.
on_both = pytest.mark.parametrize("backend", ["cpu", "gpu"])
# Positions on a coarse grid tie often; few lanes leave others empty.
roads = st.tuples(
    st.lists(st.integers(0, 12).map(lambda i: 4000.0 / 12 * i), min_size=SLOTS, max_size=SLOTS),
    st.lists(st.integers(0, LANES - 1), min_size=SLOTS, max_size=SLOTS),
    st.lists(st.booleans(), min_size=SLOTS, max_size=SLOTS),
    st.permutations(range(SLOTS)),
    st.sampled_from([-1, 1]),
    st.lists(st.sampled_from([0, 0, -1, 1]), min_size=SLOTS, max_size=SLOTS),
)


@on_both
@settings(max_examples=150)
@given(roads)
@pytest.mark.versions
def test_random_roads_with_ties(backend, road):
    """Every road, last order and side looked at; in lanes -1 and 5, off the road, nobody is found."""
    x, lane, active, previous, direction, straddles = road
    got, expected = compared(x, lane, direction, np.array(active), previous, straddles, backend)
    np.testing.assert_array_equal(np.array(got), expected)


@on_both
@pytest.mark.parametrize("seed", range(20))
def test_dense_roads(seed, backend):
    """A full road of 192 slots at continuous positions, from an arbitrary order."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, LENGTH_M + 10.0, 192)
    lane = rng.integers(0, LANES, 192)
    active = rng.random(192) < rng.choice([0.05, 0.5, 1.0])
    straddles = rng.choice([-1, 0, 0, 1], 192)
    side, previous = rng.choice([-1, 1]), rng.permutation(192)
    got, expected = compared(x, lane, side, active, previous, straddles, backend)
    np.testing.assert_array_equal(np.array(got), expected)


@on_both
@pytest.mark.parametrize("slots", [1, 2, 31, 32, 33, 64])
@pytest.mark.parametrize("lanes", [1, LANES])
def test_sizes_about_a_word_of_a_bit_set(slots, lanes, backend):
    """32 places share a word."""
    rng = np.random.default_rng(slots)
    for share in (1.0, 0.1):
        x, lane = rng.permutation(slots) * 7.0, rng.integers(0, lanes, slots)
        compared_road = x, lane, 1, rng.random(slots) < share
        got, expected = compared(*compared_road, backend=backend)
        np.testing.assert_array_equal(np.array(got), expected)


@on_both
def test_roads_by_hand(backend):
    """Nobody, one vehicle a lane, straddling, the acceleration lane, ties; brute force agrees with these, too."""
    here = {"backend": backend}
    got = assert_neighbours(
        np.linspace(0, 100, SLOTS), np.zeros(SLOTS), 1, np.zeros(SLOTS, bool), **here
    )
    np.testing.assert_array_equal(np.array(got), NOBODY)

    x = np.array([50.0, 40.0, 60.0, 30.0, 70.0])
    got = assert_neighbours(x, np.arange(5), 1, np.ones(5, bool), **here)
    np.testing.assert_array_equal([got.leader, got.follower], NOBODY)
    np.testing.assert_array_equal(got.target_leader, [NOBODY, 2, NOBODY, 4, NOBODY])
    np.testing.assert_array_equal(got.target_follower, [1, NOBODY, 3, NOBODY, NOBODY])

    x, lane = np.array([10.0, 10.0, 50.0, 90.0, 80.0]), np.array([1, 2, 1, 1, 2])
    got = assert_neighbours(x, lane, 1, np.ones(5, bool), straddles=[0, 0, 1, 0, 0], **here)
    assert (got.leader[0], got.leader[1], got.leader[2], got.target_leader[2]) == (2, 2, 3, 4)

    x, lane = np.array([120.0, 100.0, 140.0, 900.0]), np.array([4, 3, 3, 4])
    left, right = (assert_neighbours(x, lane, side, np.ones(4, bool), **here) for side in (-1, 1))
    assert (left.target_follower[0], left.target_leader[0], left.leader[0]) == (1, 2, 3)
    assert (right.target_leader[1], right.target_follower[2]) == (0, 0)

    got = assert_neighbours(np.full(4, 77.0), np.array([1, 1, 2, 1]), 1, np.ones(4, bool), **here)
    np.testing.assert_array_equal(got.leader, [1, 3, NOBODY, NOBODY])
    np.testing.assert_array_equal(got.target_leader, [2, 2, NOBODY, NOBODY])
    assert got.target_follower[3] == 2


@on_both
@pytest.mark.parametrize("target", [-1, -7, LANES, LANES + 1, 99])
def test_no_lane_there(target, backend):
    """In a target lane outside the road nobody is found."""
    active = np.arange(SLOTS) % 3 != 0
    lane = np.zeros(SLOTS, np.int32)
    x = np.linspace(0, 900, SLOTS, dtype=np.float32)
    there = np.full(SLOTS, target, np.int32)
    got, _ = found(x, lane, there, active, np.arange(SLOTS), backend=backend)
    assert (np.asarray(got.target_leader) == NOBODY).all()
    assert (np.asarray(got.target_follower) == NOBODY).all()
    assert (np.asarray(got.leader) != NOBODY).sum() == active.sum() - 1


@on_both
def test_the_most_slots_allowed(backend):
    """With as many slots as five lanes allow, the last ones are found like any other."""
    slots = 65536 // (LANES + 1) - 2
    x = np.zeros(slots, np.float32)
    x[-3:] = [30.0, 10.0, 20.0]
    active = np.arange(slots) >= slots - 3
    lane = np.where(np.arange(slots) == slots - 1, 1, 0)
    got, _ = found(x, lane, lane + 1, active, np.arange(slots), backend=backend)
    np.testing.assert_array_equal(got.leader[-3:], [NOBODY, slots - 3, NOBODY])
    np.testing.assert_array_equal(got.follower[-3:], [slots - 2, NOBODY, NOBODY])
    np.testing.assert_array_equal(got.target_leader[-3:], [NOBODY, slots - 1, NOBODY])
    np.testing.assert_array_equal(got.target_follower[-3:], [slots - 1, NOBODY, NOBODY])


def test_resolution_is_what_the_docstring_says():
    """4 km and 256 slots resolve 0.48 mm: nearer vehicles go by slot, others by position."""
    slots, resolution = 256, LENGTH_M / 2**23
    assert resolution == pytest.approx(0.48e-3, rel=0.01)
    active = jnp.arange(slots) < 3

    def order(first, second, third):
        x = np.zeros(slots, np.float32)
        x[:3] = np.array([first, second, third]) * resolution
        order = sort_by_road(jnp.asarray(x), active, LENGTH_M, jnp.arange(slots))
        return list(np.asarray(order)[:3])

    assert order(100.75, 100.25, 99.5) == [2, 0, 1]  # 0 and 1 share a step; 2 does not
    rng = np.random.default_rng(0)
    for start in rng.uniform(0, 2**23 - 4, 50):
        # Two steps apart and more is always told apart, anywhere on the road.
        assert order(start + 4.0, start + 2.0, start) == [2, 1, 0]


def test_past_the_end_sorts_last_but_before_the_inactive():
    """A vehicle that has just run over the end is the foremost one."""
    x = jnp.array([4009.0, 0.0, 4000.0, 3999.0, 5.0])
    active = jnp.array([True, True, True, True, False])
    order = sort_by_road(x, active, LENGTH_M, jnp.arange(5))
    np.testing.assert_array_equal(order, [1, 3, 2, 0, 4])


def test_a_gpu_sorts_alike_and_moves_the_keys_alone(monkeypatch):
    """Another sort gives the same order; a stable one would carry a second operand there."""
    rng = np.random.default_rng(1)
    x = jnp.asarray(np.round(rng.uniform(0, 60, SLOTS)), jnp.float32)  # with ties
    active = jnp.asarray(rng.random(SLOTS) < 0.8)
    arguments = x, active, LENGTH_M, jnp.asarray(rng.permutation(SLOTS), jnp.int32)
    expected = sort_by_road(*arguments)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    np.testing.assert_array_equal(sort_by_road(*arguments), expected)
    sorts = [eqn for eqn in jax.make_jaxpr(sort_by_road)(*arguments).eqns if "sort" in str(eqn)]
    assert all("is_stable=True" not in str(eqn) for eqn in sorts)
    assert sorts
