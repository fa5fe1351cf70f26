"""Short headways after a change of lanes: accepted at once, grown back as exp(-t / tau)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic.following import Follower, Leader, current_headway, relaxed_headway
from medjax.traffic.neighbours import NOBODY
from medjax.world.params import LaneChangeParams
from tests.traffic.reference import CAR, idm_plus
from tests.traffic.roads import Record, put

pytestmark = pytest.mark.usefixtures("quick_compiles")

USUAL, SHORTEST, TAU_S, TICK_S = 1.5, 0.56, 15.0, 0.25
PARAMS = LaneChangeParams(accepted_headway=SHORTEST, relaxation_s=TAU_S)


def spare(gap, speed, leader_speed):
    """`current_headway` of one car."""
    nobody = jnp.int32(NOBODY)
    closing = 0.5 / np.sqrt(CAR["max_acceleration"] * CAR["comfortable_deceleration"])
    keeps = CAR["time_headway"], CAR["min_gap"], CAR["max_acceleration"], closing
    follower = Follower(jnp.float32(0.0), jnp.float32(speed), *keeps, None, nobody)
    leader = Leader(jnp.float32(gap), jnp.float32(leader_speed), nobody)
    return float(current_headway(follower, leader, jnp.bool_(True)))


def relax(headway, there, is_new):
    """`relaxed_headway` of one car in a tick."""
    return float(relaxed_headway(headway, USUAL, there, jnp.bool_(is_new), TICK_S, PARAMS))


@settings(max_examples=100)
@given(st.floats(2.0, 120.0), st.floats(1.0, 33.0), st.floats(-10.0, 10.0))
def test_a_new_leader_is_accepted_at_the_current_headway(gap, speed, faster):
    """Between the shortest accepted headway and the driver's own, IDM+ in float64 gives 0 at the headway taken; else
    that is the nearer of the two."""
    leader = max(speed + faster, 0.0)
    there = spare(gap, speed, leader)
    taken = relax(USUAL, there, is_new=True)
    kept = CAR | {"time_headway": taken, "desired_speed": 1e9}
    if SHORTEST < there < USUAL:
        assert idm_plus(kept, gap, speed, min(leader, speed)) == pytest.approx(0.0, abs=1e-4)
    else:
        assert taken == pytest.approx(SHORTEST if there <= SHORTEST else USUAL)


@pytest.mark.parametrize("start", [0.3, SHORTEST, 1.0])
def test_a_short_headway_grows_back_exponentially(start):
    """T - (T - h) exp(-t / tau), to the half of a tick that explicit steps are off."""
    headway, path = start, []
    for _ in range(240):
        headway = relax(headway, 0.2, is_new=False)
        path.append(headway)
    t = TICK_S * np.arange(1, 241)
    np.testing.assert_allclose(path, USUAL - (USUAL - start) * np.exp(-t / TAU_S), atol=5e-3)


def test_a_headway_does_not_grow_beyond_the_usual_one():
    """Even if it relaxes in less than a tick."""
    for relaxation_s in (0.1, TICK_S, 0.3):
        params = PARAMS.replace(relaxation_s=relaxation_s)
        grown = relaxed_headway(SHORTEST, USUAL, 0.2, jnp.bool_(False), TICK_S, params)
        share = min(TICK_S / relaxation_s, 1.0)
        assert float(grown) == pytest.approx(SHORTEST + share * (USUAL - SHORTEST))


@given(st.floats(0.1, USUAL), st.floats(-5.0, 5.0))
def test_a_headway_is_never_shorter_than_the_current_one(headway, there):
    """A vehicle that has fallen back does not close the gap again."""
    assert relax(headway, there, is_new=False) >= min(there, USUAL) - 1e-6


def test_after_a_cut_in_the_gap_relaxes(quiet, blank, play):
    """A car moves in 20 m ahead at equal speed, for which IDM+ would brake at 2.2 m/s^2: the one behind hardly brakes,
    and the gap grows to s0 + v T as exp(-t / 15 s)."""
    env, params = quiet
    v, gap = 20.0, 20.0
    state = put(blank, [55, 56], [500.0 + gap + 5.0, 500.0], [1, 1], [v, v], [v, 30.0])
    vehicles = state.vehicles
    state = state.replace(
        vehicles=vehicles.replace(lateral_offset=vehicles.lateral_offset.at[55].set(4.0))
    )
    road = Record(play(state, params), env.config, params)
    on = road.active[:, 55]
    braking = np.diff(road.speed[on, 56]) / TICK_S
    assert idm_plus(CAR, gap, v, v) < -2.0
    assert braking.min() > -0.5
    last = CAR["min_gap"] + v * USUAL
    missing = (last - (road.x[:, 55] - 5.0 - road.x[:, 56]))[on]
    t = TICK_S * np.arange(len(missing))
    late = (t > 15.0) & (t < 60.0)
    slope = np.polyfit(t[late], np.log(missing[late]), 1)[0]
    assert -1 / slope == pytest.approx(TAU_S, rel=0.1)
    # At once the headway is the current one.
    headway = jax.device_get(play(state, params).vehicles.headway)[:, 56]
    assert headway[1] == pytest.approx((gap - 2.0) / v, abs=1e-3)
    assert (np.diff(headway[1:]) > -1e-3).all()
