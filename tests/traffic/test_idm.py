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
from medjax.traffic.following import FREE_GAP_M, leaders_and_followers
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


def test_wanted_gap_of_the_first_point():
    """s* = 76.85089 m, read back from the acceleration."""
    acceleration = float(idm_acceleration(25.0, 40.0, 20.0, **CAR))
    free = 1 - (25.0 / CAR["desired_speed"]) ** 4
    star = 40.0 * np.sqrt(free - acceleration / CAR["max_acceleration"])
    assert star == pytest.approx(76.85089, abs=1e-4)


def test_the_reference_gives_the_first_point():
    """The float64 formula of other tests gives the first acceleration above."""
    assert idm(CAR, 40.0, 25.0, 20.0) == pytest.approx(-4.210771, abs=5e-7)


def test_broadcasts():
    """Speeds along one axis and gaps along another give a table."""
    v, s = np.array([5.0, 20.0, 30.0]), np.array([10.0, 50.0])
    table = idm_acceleration(v[:, None], s, v[:, None] - 1.0, **TRUCK)
    assert table.shape == (3, 2)
    np.testing.assert_allclose(table, idm(TRUCK, s, v[:, None], v[:, None] - 1.0), rtol=1e-5)


@pytest.mark.parametrize(
    ("u", "seconds", "metres"), [(0.5, 12.05897, 101.3543), (0.9, 26.25041, 447.2337)]
)
def test_free_acceleration_from_rest(u, seconds, metres):
    """t = int dv / a(v) and x = int v dv / a(v) up to u v0, by Gauss-Legendre quadrature."""
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
def test_equilibrium_gap(speed, gap):
    """The acceleration behind an equally fast leader is zero at this gap, which is that of the closed form."""

    def at(s):
        return float(value_and_slopes(s, speed, speed, CAR)[0])

    closed = equilibrium_gap(CAR, speed)
    assert closed == pytest.approx(gap, abs=5e-5)
    assert at(closed) == pytest.approx(0.0, abs=5e-6)
    assert brentq(at, 3.0, 400.0, xtol=1e-6) == pytest.approx(gap, rel=1e-5)


@pytest.mark.parametrize("speed", [5.0, 10.0, 20.0, 25.0, 30.0])
def test_slopes_at_equilibrium(speed):
    """The derivatives by gap, leader's speed and own speed are the closed forms f_s, f_l, f_v."""
    _, found = value_and_slopes(equilibrium_gap(CAR, speed), speed, speed, CAR)
    np.testing.assert_allclose(found, slopes(CAR, speed), rtol=1e-4)


def stability(speed, params):
    """(f_v^2 - f_l^2)/2 - f_s from the package's own derivatives; string stable where not negative."""
    gap = equilibrium_gap(params, speed)
    f_s, f_l, f_v = map(float, value_and_slopes(gap, speed, speed, params)[1])
    return (f_v**2 - f_l**2) / 2 - f_s


def test_string_stability_band():
    """The car is unstable between 4.7 and 16.4 m/s; with a = 2 and b = 2 it is stable at all speeds."""
    lower = brentq(lambda v: stability(v, CAR), 2.0, 8.0, xtol=1e-3)
    upper = brentq(lambda v: stability(v, CAR), 12.0, 25.0, xtol=1e-3)
    assert lower == pytest.approx(4.7, abs=0.05)
    assert upper == pytest.approx(16.4, abs=0.05)
    brisk = CAR | {"max_acceleration": 2.0}
    assert all(stability(v, brisk) > 0 for v in np.linspace(0.5, 32.0, 40))


def test_shrinking_s_star_is_clipped():
    """Behind a leader that drives away s* is s0, whatever the leader's speed."""
    away = [float(idm_acceleration(20.0, 20.0, vl, **CAR)) for vl in (26.0, 30.0, 60.0)]
    assert away[0] == away[1] == away[2]
    expected = 1.4 * (1 - (20.0 / CAR["desired_speed"]) ** 4 - (2.0 / 20.0) ** 2)
    assert away[0] == pytest.approx(expected, rel=1e-6)


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
    _, followers = leaders_and_followers(column, gap, speed, jnp.full(len(speed), NOBODY), model)
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


def test_idm_plus_slows_down_comfortably_on_a_free_road():
    """A vehicle above its desired speed brakes by IDM's free term, at b at most."""
    u = np.linspace(1.0, 1.5, 30)
    got = behind(IDM_PLUS, CAR, u * CAR["desired_speed"], FREE_GAP_M, 0.0)
    np.testing.assert_allclose(got, np.maximum(1.4 * (1 - u**4), -2.0), atol=2e-5)
    assert got.min() == -2.0
