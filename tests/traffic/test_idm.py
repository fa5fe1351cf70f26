"""IDM and IDM+ against numbers of the literature, closed forms, and the formulas in float64."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar

from medjax.traffic import idm_acceleration
from medjax.traffic.following import FREE_GAP_M, roles
from medjax.traffic.idm import IDM, IDM_PLUS, SMALLEST_GAP_M
from medjax.traffic.neighbours import NOBODY
from tests.traffic.cars import drivers
from tests.traffic.reference import CAR, HIGHWAY, TRUCK, equilibrium_gap, idm, idm_plus, slopes

NAMED = {"car": CAR, "highway": HIGHWAY, "truck": TRUCK}


def test_point_accelerations():
    """Of whole arrays; gap, speed, leader's speed, expected."""
    gap, speed, leader, expected = np.transpose(
        [
            (40.0, 25.0, 20.0, -4.210771),
            (30.0, 20.0, 20.0, -0.374329),
            (100.0, 22.0, 0.0, -3.382648),
            (20.0, 20.0, 30.0, 1.204560),
            (5.0, 0.0, 0.0, 1.176),
        ]
    )
    got = idm_acceleration(speed, gap, leader, **CAR)
    np.testing.assert_allclose(got, expected, rtol=2e-6, atol=5e-7)


@pytest.mark.parametrize(
    ("params", "length", "capacity", "at"),
    [(CAR, 5.0, 1836.4, 18.77), (CAR, 12.0, 1558.9, None), (HIGHWAY, 5.0, 2519.2, None)],
)
def test_lane_capacity(params, length, capacity, at):
    """The best v / (s_e + L), with s_e found from the package's acceleration."""

    idm = jax.jit(functools.partial(idm_acceleration, **params))

    def flow(v):
        gap = brentq(lambda s: float(idm(v, s, v)), 2.0, 2e3, xtol=1e-6)
        return 3600 * v / (gap + length)

    best = minimize_scalar(lambda v: -flow(v), bounds=(8.0, 30.0), method="bounded")
    assert -best.fun == pytest.approx(capacity, abs=0.1)
    if at is not None:
        assert best.x == pytest.approx(at, abs=0.02)


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2))
def value_and_slopes(gap, leader, speed, params):
    """Acceleration, and its derivatives (f_s, f_l, f_v) by gap, leader's speed and own speed."""
    return idm_acceleration(speed, gap, leader, **params)


@pytest.mark.parametrize(
    ("speed", "gap"), [(10.0, 17.0693), (20.0, 34.2997), (25.0, 47.7747), (30.0, 80.1460)]
)
def test_equilibrium(speed, gap):
    """No acceleration at this gap behind an equally fast leader, and the slopes there are those of the closed form."""
    closed = equilibrium_gap(CAR, speed)
    assert closed == pytest.approx(gap, abs=5e-5)
    value, found = value_and_slopes(closed, speed, speed, CAR)
    assert float(value) == pytest.approx(0.0, abs=5e-6)
    np.testing.assert_allclose(found, slopes(CAR, speed), rtol=1e-4)


@pytest.mark.parametrize("exponent", [1.0, 2.0, 4.0, 8.0])
def test_exponent_on_a_free_road(exponent):
    """a [1 - (v/v0)^exponent]: full at rest, zero at v0, braking above."""
    u = np.array([0.0, 0.3, 0.8, 1.0, 1.2])
    v = u * CAR["desired_speed"]
    free = idm_acceleration(v, FREE_GAP_M, v, **CAR, exponent=exponent)
    np.testing.assert_allclose(free, 1.4 * (1 - u**exponent), rtol=1e-5, atol=1e-6)


@settings(max_examples=60)
@given(
    st.sampled_from(sorted(NAMED)),
    st.floats(0.2, 500.0),
    st.floats(0.0, 45.0),
    st.floats(0.0, 45.0),
)
def test_everywhere_as_printed_and_smooth(name, gap, speed, leader):
    """The printed formula in float64, and finite slopes, for every car, gap and speed."""
    params = NAMED[name]
    got, found = value_and_slopes(gap, leader, speed, params)
    np.testing.assert_allclose(got, idm(params, gap, speed, leader), rtol=1e-5, atol=1e-5)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("gap", [SMALLEST_GAP_M, 0.0, -3.0])
def test_overlap_brakes_hard(gap):
    """Beyond any tyre, with finite values and slopes."""
    value, found = value_and_slopes(gap, 10.0, 10.0, CAR)
    assert -np.inf < value < -9.0
    assert np.isfinite(found).all()


def behind(model, kind, speed, gap, leader_speed):
    """Acceleration of drivers of one kind by a model, as the simulator asks it; `(N,)` each."""
    speed, gap, leader_speed = (
        jnp.asarray(v, jnp.float32) for v in np.broadcast_arrays(speed, gap, leader_speed)
    )
    column = drivers([kind] * len(speed))
    _, followers = roles(column, gap, speed, jnp.full(len(speed), NOBODY), model)
    return np.asarray(model.acceleration(followers, gap, leader_speed), np.float64)


@settings(max_examples=40)
@given(st.sampled_from(sorted(NAMED)), st.integers(0, 2**32 - 1))
def test_the_models_of_the_simulator_are_as_printed(name, seed):
    """IDM and IDM+ in float64, for every car, gap and speed, on free roads and above the desired speed."""
    kind, rng = NAMED[name], np.random.default_rng(seed)
    speed, leader = rng.uniform(0.0, 50.0, (2, 64))
    gap = np.append(rng.uniform(0.2, 300.0, 56), np.full(8, FREE_GAP_M))
    for model, printed in ((IDM(), idm), (IDM_PLUS, idm_plus)):
        got = behind(model, kind, speed, gap, leader)
        np.testing.assert_allclose(got, printed(kind, gap, speed, leader), rtol=2e-5, atol=1e-5)


@pytest.mark.parametrize("name", sorted(NAMED))
def test_idm_plus_keeps_a_constant_time_headway(name):
    """s0 + v T is its equilibrium at any speed below the desired one; IDM asks for more."""
    kind = NAMED[name]
    speed = np.linspace(0.1, 0.999, 200) * kind["desired_speed"]
    gap = kind["min_gap"] + speed * kind["time_headway"]
    np.testing.assert_allclose(behind(IDM_PLUS, kind, speed, gap, speed), 0.0, atol=1e-5)
    assert (behind(IDM_PLUS, kind, speed, 1.01 * gap, speed) > 0.0).all()
    assert (behind(IDM_PLUS, kind, speed, 0.99 * gap, speed) < 0.0).all()
    assert (behind(IDM(), kind, speed[1:], gap[1:], speed[1:]) < 0.0).all()
