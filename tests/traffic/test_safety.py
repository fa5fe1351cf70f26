"""No vehicle that keeps to the bound touches its leader, whatever both do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from medjax.traffic.motion import ballistic_step
from medjax.traffic.safety import (
    CLEARANCE_M,
    BrakingLimits,
    can_follow_safely,
    safe_acceleration,
    safe_speed,
    stopping_room,
)

BRAKING = st.floats(1.0, 50.0)
TICK = st.floats(0.05, 0.5)
SEEDS = st.integers(0, 2**32 - 1)
PAIRS = 64


@jax.jit
def bound(gap, speed, leader_speed, limits):
    return safe_acceleration(speed, stopping_room(gap, leader_speed, limits), limits)


def drive(rng, gap, speed, leader_speed, limits, most, ticks=200):
    """Smallest gaps of pairs whose drivers do anything within the package's bound; motion in float64."""
    x, ahead, smallest = np.zeros_like(gap), gap, gap
    brakes_at = rng.integers(0, ticks, gap.shape)  # a leader that brakes for good from some tick on
    for tick in range(ticks):
        safe = np.asarray(bound(ahead - x, speed, leader_speed, limits), np.float64)
        told = np.minimum(rng.uniform(-5.0, most, gap.shape), safe)
        told = np.clip(told, -limits.braking, most)
        leads = rng.uniform(-limits.braking, most, gap.shape)
        leads = np.where(tick >= brakes_at, -limits.braking, leads)
        x, speed = _exact(x, speed, told, limits.tick_s)
        ahead, leader_speed = _exact(ahead, leader_speed, leads, limits.tick_s)
        smallest = np.minimum(smallest, ahead - x)
    return smallest


def _exact(x, speed, acceleration, dt):
    """A tick of constant acceleration that ends at a standstill."""
    stops = speed + acceleration * dt < 0.0
    lasts = np.where(stops, speed / np.where(stops, -acceleration, 1.0), dt)
    after = np.where(stops, 0.0, speed + acceleration * lasts)
    return x + speed * lasts + 0.5 * acceleration * lasts**2, after


@settings(max_examples=60)
@given(SEEDS, BRAKING, TICK, st.floats(0.1, 20.0))
def test_nobody_touches_its_leader(seed, braking, tick, most):
    """From the fastest start that the gap allows."""
    rng, limits = np.random.default_rng(seed), BrakingLimits(braking, tick)
    gap, leader_speed = rng.uniform(0.1, 60.0, PAIRS), rng.uniform(0.0, 60.0, PAIRS)
    speed = np.asarray(safe_speed(jnp.asarray(gap), jnp.asarray(leader_speed), braking))
    smallest = drive(rng, gap, speed.astype(np.float64), leader_speed, limits, most)
    assert smallest.min() > 0.0
    # Without the margin it would be touched: the bound is not just far off.
    assert smallest.min() < 30.0


@pytest.mark.thorough
@settings(max_examples=60)
@given(SEEDS, BRAKING, TICK, st.floats(0.1, 20.0))
def test_a_vehicle_that_keeps_clear_can_fall_in(seed, braking, tick, most):
    """After a tick at full acceleration, with the new leader braking as hard as it can."""
    rng, limits = np.random.default_rng(seed), BrakingLimits(braking, tick)
    gap, leader_speed = rng.uniform(0.1, 80.0, PAIRS), rng.uniform(0.0, 60.0, PAIRS)
    speed = rng.uniform(0.0, 60.0, PAIRS)
    clear = np.asarray(can_follow_safely(speed, most, gap, leader_speed, limits))
    assume(clear.any())
    x, speed = _exact(np.zeros(PAIRS), speed, np.full(PAIRS, most), tick)
    ahead, leader_speed = _exact(gap, leader_speed, np.full(PAIRS, -braking), tick)
    smallest = drive(rng, ahead - x, speed, leader_speed, limits, most)
    assert smallest[clear].min() > 0.0


def test_the_bound_is_tight():
    """A leader that stands: full braking stops CLEARANCE_M before it, and half a metre less would not."""
    limits, speed = BrakingLimits(8.0, 0.25), 20.0
    way = speed**2 / (2.0 * 8.0)
    assert float(bound(way + CLEARANCE_M, speed, 0.0, limits)) == pytest.approx(-8.0, rel=1e-5)
    assert float(bound(way - 0.5, speed, 0.0, limits)) < -8.0
    assert not bool(can_follow_safely(speed, 1.0, way + CLEARANCE_M, 0.0, limits))


def test_the_bound_does_not_bind_in_ordinary_traffic():
    """At 110 km/h and an accepted headway of 0.56 s, the shortest of LMRS, a leader may brake at 4 m/s^2 for a tick."""
    assert float(bound(2.0 + 0.56 * 30.0, 30.0, 29.0, BrakingLimits(9.0, 0.25))) > 0.0


def test_a_stop_within_the_tick():
    """Slow and near: the ballistic step ends where the gap does."""
    acceleration = bound(0.10 + CLEARANCE_M, 1.0, 0.0, BrakingLimits(9.0, 0.5))
    x, speed = ballistic_step(jnp.float32(0.0), jnp.float32(1.0), acceleration, 0.5)
    np.testing.assert_allclose(float(x), 0.10, rtol=1e-5)
    assert float(speed) == 0.0
