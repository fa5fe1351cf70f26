"""Vehicles enter where there is room, and never so that they have to crash."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.demand import Entries
from medjax.traffic.entry_gap import Ahead, cut_off, entry_speed, next_ahead
from medjax.traffic.safety import Tyres

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


def test_who_straddles_an_entrys_lane_is_not_cut_off():
    """From 30 m/s it stops in 50 m and what a tick adds; who is in another lane, or past the entry, does not count."""
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
        assert bool(cut_off(where, jnp.array([5.0]), *one, Tyres(9.0, 0.25))[0]) is blocked


DRIVER_CASES = st.tuples(
    st.floats(0.0, 300.0),  # gap, m
    st.floats(0.0, 35.0),  # speed ahead, m/s
    st.floats(15.0, 35.0),  # wanted, m/s
    st.sampled_from([(1.5, 2.0, 1.4), (2.0, 4.0, 1.0)]),  # headway, standing gap, acceleration
    st.booleans(),  # the vehicle ahead brakes to a stop
)


@jax.jit
def smallest_gap_after(gap, speed, ahead_speed, headway, min_gap, acceleration, ahead_brakes):
    """Smallest gap in 60 s of IDM at tick 0.25 with braking limited to 9 m/s^2, as physics_tick does."""

    def tick(carry, _):
        x, v, xl, vl = carry
        a = idm_acceleration(
            v,
            xl - x,
            vl,
            desired_speed=30.0,
            time_headway=headway,
            min_gap=min_gap,
            max_acceleration=acceleration,
            comfortable_deceleration=2.0,
        )
        x, v = ballistic_step(x, v, jnp.clip(a, -9.0, acceleration), 0.25)
        xl, vl = ballistic_step(xl, vl, jnp.where(ahead_brakes, -4.0, 0.0), 0.25)
        return (x, v, xl, vl), xl - x

    start = (jnp.float32(0.0), speed, gap, ahead_speed)
    return jax.lax.scan(tick, start, length=240)[1].min()


@settings(max_examples=300, deadline=None)
@given(DRIVER_CASES)
def test_entry_speed_is_never_unsafe(case):
    """Who may enter never touches the vehicle ahead, even if that one brakes at 4 m/s^2 to a stop."""
    gap, ahead_speed, wanted, (headway, min_gap, acceleration), brakes = case
    gap, ahead_speed = jnp.float32(gap), jnp.float32(ahead_speed)
    speed, safe = entry_speed(jnp.float32(wanted), Ahead(gap, ahead_speed), headway, min_gap, 9.0)
    assert speed <= wanted
    if safe:
        assert gap >= min_gap + headway * speed
        closest = smallest_gap_after(
            gap, speed, ahead_speed, headway, min_gap, acceleration, brakes
        )
        assert closest > 0.0


def test_entry_on_an_empty_road():
    """Nobody ahead: at the wanted speed."""
    speed, safe = entry_speed(
        jnp.float32(28.0), Ahead(jnp.float32(jnp.inf), jnp.float32(0.0)), 1.5, 2.0, 9.0
    )
    assert (float(speed), bool(safe)) == (28.0, True)


def test_entry_behind_a_vehicle_too_close():
    """Refused below the safe gap, at any speed of the one ahead."""
    ahead = Ahead(jnp.array([-1.0, 1.9, 31.0]), jnp.array([0.0, 0.0, 20.0]))
    _, safe = entry_speed(jnp.full(3, 25.0), ahead, 1.5, 2.0, 9.0)
    assert not safe.any()
