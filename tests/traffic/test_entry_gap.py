"""Vehicles enter where there is room, and never so that they have to crash."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.demand import Entries
from medjax.traffic.entry_gap import Ahead, entry_speed, next_ahead, would_cut_off
from medjax.traffic.safety import BrakingLimits

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_next_ahead():
    """Nearest rear bumper in the lane, a vehicle on the entry itself included, and one that straddles a line."""
    where = Entries(jnp.array([0.0, 0.0, 0.0, 100.0, 0.0]), jnp.array([0, 1, 2, 4, 3]))
    x = jnp.array([300.0, 80.0, 3.0, 150.0, 40.0, 90.0, 20.0])
    lane = jnp.array([0, 0, 1, 4, 2, 4, 2])
    other = jnp.array([-2, -2, -2, -2, -2, -2, 3])
    speed = jnp.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    active = jnp.array([True, True, True, True, False, True, True])
    ahead = next_ahead(where, x, lane, other, jnp.full(7, 5.0), speed, active)
    np.testing.assert_allclose(ahead.gap, [75.0, -2.0, 15.0, 45.0, 15.0])
    np.testing.assert_allclose(ahead.speed, [2.0, 3.0, 7.0, 4.0, 7.0])


def test_a_vehicle_straddling_an_entrys_lane_is_not_cut_off():
    """From 30 m/s it stops in 50 m and what a tick adds; another lane, or past the entry, does not count."""
    where = Entries(jnp.array([300.0]), jnp.array([4]))
    for x, other, speed, blocked in (
        (250.0, 4, 30.0, True),
        (200.0, 4, 30.0, False),
        (280.0, 4, 2.0, False),
        (294.0, 4, 3.0, True),
        (250.0, 3, 30.0, False),
        (301.0, 4, 30.0, False),
    ):
        one = jnp.array([x]), jnp.array([other]), jnp.array([speed]), jnp.array([1.4])
        assert (
            bool(would_cut_off(where, jnp.array([5.0]), *one, BrakingLimits(9.0, 0.25))[0])
            is blocked
        )


@jax.jit
def smallest_gap_after(gap, speed, ahead_speed, headway, min_gap, acceleration, ahead_brakes):
    """Smallest gap in 60 s of IDM at tick 0.25 with braking limited to 9 m/s^2, as physics_tick does."""

    kept = {"desired_speed": 30.0, "time_headway": headway, "min_gap": min_gap}
    kept |= {"max_acceleration": acceleration, "comfortable_deceleration": 2.0}

    def tick(carry, _):
        x, v, xl, vl = carry
        a = idm_acceleration(v, xl - x, vl, **kept)
        x, v = ballistic_step(x, v, jnp.clip(a, -9.0, acceleration), 0.25)
        xl, vl = ballistic_step(xl, vl, jnp.where(ahead_brakes, -4.0, 0.0), 0.25)
        return (x, v, xl, vl), xl - x

    start = (jnp.float32(0.0), speed, gap, ahead_speed)
    return jax.lax.scan(tick, start, length=240)[1].min()


@settings(max_examples=300)
@given(
    st.floats(0.0, 300.0),
    st.floats(0.0, 35.0),
    st.floats(15.0, 35.0),
    st.sampled_from([(1.5, 2.0, 1.4), (2.0, 4.0, 1.0)]),
    st.booleans(),
)
def test_entry_speed_is_never_unsafe(gap, ahead_speed, wanted, driver, brakes):
    """The newcomer never touches the vehicle ahead, even if that one brakes at 4 m/s^2 to a stop.

    Args:
      driver: headway, standing gap, acceleration.
    """
    headway, min_gap, _ = driver
    gap, ahead_speed = jnp.float32(gap), jnp.float32(ahead_speed)
    speed, safe = entry_speed(jnp.float32(wanted), Ahead(gap, ahead_speed), headway, min_gap, 9.0)
    assert speed <= wanted
    if safe:
        assert gap >= min_gap + headway * speed
        assert smallest_gap_after(gap, speed, ahead_speed, *driver, brakes) > 0.0


def test_entry_on_an_empty_road_or_too_close():
    """At the wanted speed; refused below the safe gap, at any speed of the vehicle ahead."""
    ahead = Ahead(jnp.array([jnp.inf, -1.0, 1.9, 31.0]), jnp.array([0.0, 0.0, 0.0, 20.0]))
    wanted = jnp.array([28.0, 25.0, 25.0, 25.0])
    speed, safe = entry_speed(wanted, ahead, 1.5, 2.0, 9.0)
    assert speed[0] == 28.0
    np.testing.assert_array_equal(safe, [True, False, False, False])
