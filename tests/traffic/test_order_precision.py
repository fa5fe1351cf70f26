"""The order of vehicles at the resolution of float32 and packed sort keys; bounds: docs/precision.md."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.observation import STEPS
from medjax.traffic import find_neighbours, sort_by_road
from medjax.traffic.neighbours import NOBODY
from medjax.traffic.road import NO_LANE
from medjax.world.params import CHARGING_SLOTS, EnvConfig, validate_config
from tests.traffic.reference import brute_force

pytestmark = pytest.mark.usefixtures("quick_compiles")

LENGTH_M = 100_000.0
ULP_M = float(np.spacing(np.float32(LENGTH_M)))  # 7.8 mm


@jax.jit
def found(x, lane, target, length_m):
    order = sort_by_road(x, jnp.ones(x.shape, bool), length_m, jnp.arange(x.size))
    nowhere = jnp.full(x.shape, NO_LANE)
    return find_neighbours(order, lane, nowhere, target, jnp.ones(x.shape, bool), 5)


def abreast_road(length_m, slots, shift_m, rng, spacing_m=5.0):
    """Lanes 0 to 4 with the same grid of places at least spacing_m apart, each shifted by up to shift_m."""
    places = slots // 5
    room = length_m / places - spacing_m - 2 * shift_m
    grid = (np.arange(places) + rng.uniform(0.0, 1.0, places) * room / (length_m / places)) * (
        length_m / places
    )
    x = (grid[:, None] + rng.uniform(0.0, shift_m, (places, 5))).ravel()
    lane = np.tile(np.arange(5), places)
    mixed = rng.permutation(x.size)
    return x[mixed].astype(np.float32), lane[mixed].astype(np.int32)


@pytest.mark.parametrize("direction", [-1, 1])
def test_order_on_the_long_road(direction):
    """100 km and 2510 slots resolve 19 cm. Within a lane the order is that of float64. Towards the next lane it may
    differ for two vehicles abreast, between which no gap is safe in either order."""
    rng = np.random.default_rng(2)
    resolution = LENGTH_M / 2 ** (31 - 12)
    swapped = 0
    for _ in range(5):
        x, lane = abreast_road(LENGTH_M, 2510, 2 * resolution, rng)
        target = lane + direction
        got = found(x, lane, target, LENGTH_M)
        x = x.astype(np.float64)
        np.testing.assert_array_equal([got.leader, got.follower], brute_force(x, lane, lane))
        exact = np.array(brute_force(x, lane, target))
        seen = np.array([got.target_leader, got.target_follower])
        wrong = (seen != exact).any(axis=0)
        swapped += wrong.sum()

        def fits(ahead, behind, x=x):
            """Bumper gaps on both sides are positive, for vehicles of 5 m."""
            front = np.where(ahead == NOBODY, np.inf, x[ahead] - 5.0 - x)
            back = np.where(behind == NOBODY, np.inf, x - 5.0 - x[behind])
            return (front > 0.0) & (back > 0.0)

        np.testing.assert_array_equal(fits(*seen), fits(*exact))
        assert not fits(*exact)[wrong].any()
        nearest = np.abs(x[seen] - x)[:, wrong].min(axis=0)
        assert (nearest <= resolution + 2 * ULP_M).all()
    assert swapped > 50  # the case was there


def test_order_in_a_lane_is_right_if_a_vehicle_is_longer_than_the_resolution():
    """length_m / 2^(31 - slot bits); on a longer road it is wrong."""
    slots, vehicle_m = 2510, 5.0
    longest = vehicle_m * 2 ** (31 - 12)
    assert longest > 20 * LENGTH_M

    def mistakes(length_m):
        rng = np.random.default_rng(3)
        pairs = rng.uniform(0.0, length_m - 100.0, slots // 2)
        x = np.stack([pairs, pairs + vehicle_m + 0.5], axis=1).ravel().astype(np.float32)
        lane = np.zeros(slots, np.int32)
        assert (np.diff(np.sort(x))[::2] > 0).all()
        mixed = rng.permutation(slots)
        got = found(x[mixed], lane, lane + 1, length_m)
        ahead, _ = brute_force(x[mixed].astype(np.float64), lane, lane)
        return np.sum(np.asarray(got.leader) != ahead)

    assert mistakes(0.99 * longest) == 0
    assert mistakes(4.0 * longest) > 0


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_the_largest_configuration_fits_its_counters(backend, monkeypatch):
    """Places in 16 bits, slot names in 15, counts in 24: brute force on the most vehicles allowed."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    largest = EnvConfig(num_meds=64, num_evs=4096, num_gas=4096, num_lanes=5, num_ramps=8)
    validate_config(largest)
    lanes = largest.num_lanes + 1
    slots = 2**16 // (lanes + 1) - 2  # the most that `find_neighbours` allows
    assert largest.num_vehicles <= slots < 2**15
    find = jax.jit(lambda *road: find_neighbours(*road, lanes))
    rng = np.random.default_rng(4)
    x = rng.permutation(slots).astype(np.float32) * 20.0
    # All in one lane but a few: the counts of the packed words are as large as they get.
    for crowded in range(lanes):
        lane = np.where(rng.random(slots) < 0.99, crowded, rng.integers(0, lanes, slots))
        lane = lane.astype(np.int32)
        order = jnp.argsort(x).astype(jnp.int32)
        nowhere, everyone = np.full(slots, NO_LANE), np.ones(slots, bool)
        got = find(order, lane, nowhere, lane + 1, everyone)
        expected = *brute_force(x, lane, lane), *brute_force(x, lane, lane + 1)
        np.testing.assert_array_equal(np.array(got), expected)


def test_a_gpu_rounds_no_count_and_no_profile(monkeypatch):
    """It would round the factors of a product to 11 bits, and counts of several lanes take 24."""

    def products(jaxpr):
        for equation in jaxpr.eqns:
            if equation.primitive.name == "dot_general":
                yield equation
            for inner in jax.tree.leaves(
                list(equation.params.values()), is_leaf=lambda p: hasattr(p, "eqns")
            ):
                if hasattr(inner := getattr(inner, "jaxpr", inner), "eqns"):
                    yield from products(inner)

    env, params = medjax.make("paper", observation="profile")
    key, action = jax.random.key(0), jnp.int32(1)
    state = jax.eval_shape(env.reset, key, params)[1]

    def products_of(function, *given):
        # Each trace needs a function of its own, or JAX would return the one before.
        return len(list(products(jax.make_jaxpr(lambda *x: function(*x))(*given).jaxpr)))

    decision = env.step_env, key, state, action, params
    of_profile, on_cpu = products_of(env.get_obs, state, params), products_of(*decision)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert on_cpu > products_of(*decision) == of_profile > 0
    # Whole numbers up to here are exact, and those of the profile are at most a MED's slots in steps.
    assert len(CHARGING_SLOTS) * STEPS <= 2**11
