"""IDM and IDM+ against numbers of the literature, closed forms, and the formulas in float64."""

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
    ("speed", "gap"), [(10.0, 17.0693), (20.0, 34.2997), (25.0, 47.7747), (30.0, 80.1460)]
)
def test_equilibrium_gap(speed, gap):
    """Behind an equally fast leader nobody accelerates at this gap, and only there."""

    def at(s):
        return float(idm_acceleration(speed, s, speed, **CAR))

    assert brentq(at, 3.0, 400.0, xtol=1e-6) == pytest.approx(gap, rel=1e-5)
    assert equilibrium_gap(CAR, speed) == pytest.approx(gap, abs=5e-5)


@pytest.mark.parametrize(
    ("u", "seconds", "metres"), [(0.5, 12.05897, 101.3543), (0.9, 26.25041, 447.2337)]
)
def test_free_acceleration_from_rest(u, seconds, metres):
    """t = int dv / a(v) and x = int v dv / a(v), by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    top = u * CAR["desired_speed"]
    v = 0.5 * top * (nodes + 1)
    acceleration = np.asarray(idm_acceleration(v, FREE_GAP_M, v, **CAR), np.float64)
    assert np.sum(0.5 * top * weights / acceleration) == pytest.approx(seconds, rel=1e-6)
    assert np.sum(0.5 * top * weights * v / acceleration) == pytest.approx(metres, rel=1e-6)


@pytest.mark.parametrize(
    ("params", "length", "capacity", "at"),
    [(CAR, 5.0, 1836.4, 18.77), (CAR, 12.0, 1558.9, None), (HIGHWAY, 5.0, 2519.2, None)],
)
def test_lane_capacity(params, length, capacity, at):
    """The best v / (s_e + L), with s_e found from the package's acceleration."""

    def flow(v):
        gap = brentq(lambda s: float(idm_acceleration(v, s, v, **params)), 2.0, 2e3, xtol=1e-6)
        return 3600 * v / (gap + length)

    best = minimize_scalar(lambda v: -flow(v), bounds=(8.0, 30.0), method="bounded")
    assert -best.fun == pytest.approx(capacity, abs=0.1)
    if at is not None:
        assert best.x == pytest.approx(at, abs=0.02)


def slopes_at_equilibrium(params, v):
    """(f_s, f_l, f_v), derivatives of the package's acceleration by gap, leader's speed and own speed."""
    slope = jax.grad(lambda s, vl, v: idm_acceleration(v, s, vl, **params), argnums=(0, 1, 2))
    return [float(each) for each in slope(equilibrium_gap(params, v), v, v)]


@pytest.mark.parametrize("speed", [5.0, 10.0, 20.0, 30.0])
def test_slopes(speed):
    np.testing.assert_allclose(slopes_at_equilibrium(CAR, speed), slopes(CAR, speed), rtol=1e-4)


def test_string_stability_band():
    """(f_v^2 - f_l^2)/2 - f_s < 0 between 4.7 and 16.4 m/s, and with a = 2, b = 2 nowhere."""

    def stability(speed, params=CAR):
        f_s, f_l, f_v = slopes_at_equilibrium(params, speed)
        return (f_v**2 - f_l**2) / 2 - f_s

    assert brentq(stability, 2.0, 8.0, xtol=1e-3) == pytest.approx(4.7, abs=0.05)
    assert brentq(stability, 12.0, 25.0, xtol=1e-3) == pytest.approx(16.4, abs=0.05)
    brisk = CAR | {"max_acceleration": 2.0}
    assert all(stability(v, brisk) > 0 for v in np.linspace(0.5, 32.0, 40))


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
    got = idm_acceleration(speed, gap, leader, **params)
    np.testing.assert_allclose(got, idm(params, gap, speed, leader), rtol=1e-5, atol=1e-5)
    slope = jax.grad(lambda s, v, vl: idm_acceleration(v, s, vl, **params), argnums=(0, 1, 2))
    assert np.isfinite(slope(gap, speed, leader)).all()


@pytest.mark.parametrize("gap", [SMALLEST_GAP_M, 0.0, -3.0])
def test_overlap_brakes_hard(gap):
    """Beyond any tyre, with finite values and slopes."""
    value, slope = jax.value_and_grad(lambda s: idm_acceleration(10.0, s, 10.0, **CAR))(gap)
    assert -np.inf < value < -9.0
    assert jnp.isfinite(slope)


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
