"""Columns of cars, moved by the package, against theory and an ODE solver."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.following import (
    Drivers,
    Platooning,
    following_acceleration,
    leaders_and_followers,
)
from medjax.traffic.idm import IDM_PLUS, STANDARD_IDM
from medjax.traffic.neighbours import NOBODY
from tests.traffic.cars import LENGTH, drivers
from tests.traffic.reference import CAR, HIGHWAY, equilibrium_gap, gain, idm, sampled_gain


class Column(NamedTuple):
    """Cars of one lane, the foremost first."""

    drivers: Drivers
    x: jax.Array
    speed: jax.Array
    platoon: jax.Array


def column(x, speed, params, platoon=NOBODY, leader_speed=None):
    """Cars at x; the first one's desired speed may be given, which makes it drive at that."""
    count = len(x)
    first = params if leader_speed is None else params | {"desired_speed": leader_speed}
    return Column(
        drivers([first] + [params] * (count - 1)),
        jnp.asarray(x, jnp.float32),
        jnp.full(count, jnp.float32(speed)),
        jnp.full(count, platoon),
    )


@functools.partial(jax.jit, static_argnames=("steps", "dt", "model"))
def drive(cars, dt, steps, model=STANDARD_IDM):
    """(x, speed), (steps, N) each, after every tick; nobody ahead of the first car."""
    first = jnp.arange(cars.x.shape[0]) == 0

    def tick(state, _):
        leaders, followers = leaders_and_followers(cars.drivers, *state, cars.platoon, model)
        ahead = jax.tree.map(lambda field: jnp.roll(field, 1), leaders)
        a = following_acceleration(followers, ahead, ~first, Platooning(0.3, 2.0), model)
        state = ballistic_step(*state, a, dt)
        return state, state

    return jax.lax.scan(tick, (cars.x, cars.speed), length=steps)[1]


class Wave(NamedTuple):
    """A leader at mean + swing sin(w t), m/s, and the gap behind it that is equilibrium at mean, m."""

    gap: float
    mean: float
    w: float
    swing: float


@functools.partial(jax.jit, static_argnames=("count", "dt", "steps"))
def follow(params, wave, count, dt, steps):
    """Speeds (steps, count) of cars behind a leader that swings, from equilibrium.

    Each x is the distance from the car's own place in a frame that moves at the mean speed, for float32's sake.
    """
    gap, mean, w, swing = wave

    def tick(carry, step):
        x, speed = carry
        t = step * dt
        ahead = jnp.append(swing / w * (1 - jnp.cos(w * t)), x[:-1])
        faster = jnp.append(mean + swing * jnp.sin(w * t), speed[:-1])
        a = idm_acceleration(speed, gap + ahead - x, faster, **params)
        x, speed = ballistic_step(x, speed, a, dt)
        return (x - mean * dt, speed), speed

    start = jnp.zeros(count), jnp.full(count, mean)
    return jax.lax.scan(tick, start, jnp.arange(steps))[1]


def amplitude(signal, w, dt):
    """Amplitude at w of the last whole periods of a signal."""
    periods = int(len(signal) * dt * w / (2 * np.pi)) // 2
    steps = round(periods * 2 * np.pi / w / dt)
    t = dt * np.arange(steps)
    y = np.asarray(signal[-steps:], np.float64)
    basis = np.stack([np.sin(w * t), np.cos(w * t), np.ones(steps)], axis=1)
    sine, cosine, _ = np.linalg.lstsq(basis, y, rcond=None)[0]
    return np.hypot(sine, cosine)


def measured_gain(v, w, dt, swing=0.05):
    """One car's amplitude over its leader's."""
    steps = round((8 * 2 * np.pi / w + 60.0) / dt)
    speed = follow(CAR, Wave(equilibrium_gap(CAR, v), v, w, swing), 1, dt, steps)
    return amplitude(speed[:, 0], w, dt) / swing


def test_gain_of_a_swinging_leader():
    """|G(0.2)| = 0.92343 at 20 m/s, by the closed form, by its sampled form, and measured with short ticks."""
    assert gain(CAR, 20.0, 0.2) == pytest.approx(0.92343, abs=5e-6)
    assert sampled_gain(CAR, 20.0, 0.2, 1e-5) == pytest.approx(0.92343, rel=1e-4)
    assert measured_gain(20.0, 0.2, dt=0.01) == pytest.approx(0.92343, rel=5e-4)


@pytest.mark.parametrize("v", [10.0, 20.0, 28.0])
@pytest.mark.parametrize("w", [0.1, 0.2, 0.5])
def test_gain_at_the_simulators_tick(v, w):
    """At dt 0.25 the gain is that of the linear car sampled so, which is |G| within 5 %."""
    expected = sampled_gain(CAR, v, w, 0.25)
    assert measured_gain(v, w, dt=0.25) == pytest.approx(expected, rel=1e-4)
    assert expected == pytest.approx(gain(CAR, v, w), rel=0.05)


def test_a_swing_grows_in_the_unstable_band_and_dies_outside():
    """Along a column of 20 each car multiplies a slow swing by |G|."""
    w, dt, swing = 0.1, 0.25, 0.01
    for v, grows in ((10.0, True), (25.0, False)):
        speed = follow(CAR, Wave(equilibrium_gap(CAR, v), v, w, swing), 20, dt, 4000)
        last = amplitude(speed[:, -1], w, dt) / swing
        assert last == pytest.approx(sampled_gain(CAR, v, w, dt) ** 20, rel=0.01)
        assert (last > 1) == grows


def exact_discharge(count, times):
    """Positions (len(times), count) of a queue that starts, by an adaptive float64 solver."""
    start = -(CAR["min_gap"] + LENGTH) * np.arange(count)

    def ode(_, state):
        x, v = state[:count], np.maximum(state[count:], 0.0)
        gap = np.concatenate([[1e6], x[:-1] - LENGTH - x[1:]])
        leader = np.concatenate([v[:1], v[:-1]])
        return np.concatenate([v, idm(CAR, gap, v, leader)])

    state = np.concatenate([start, np.zeros(count)])
    solved = solve_ivp(ode, (0, times[-1]), state, t_eval=times, rtol=1e-8, atol=1e-8)
    return solved.y[:count].T


def discharge(count, dt, seconds):
    x = -(CAR["min_gap"] + LENGTH) * np.arange(count)
    return drive(column(x, 0.0, CAR), dt, round(seconds / dt))


def test_discharging_platoon_solves_the_equations():
    """Ten cars from a queue stay within half a tick's way of the exact solution for a minute."""
    exact = exact_discharge(10, 0.25 * np.arange(1, 241))
    error = np.abs(discharge(10, 0.25, 60.0)[0] - exact).max()
    finer = np.abs(discharge(10, 0.025, 60.0)[0][9::10] - exact).max()
    assert error < 0.5 * 0.25 * CAR["desired_speed"]
    assert finer < 0.12 * error  # first order: a tenth of the tick, a tenth of the error


def test_discharge_of_a_queue():
    """Flow below the lane's capacity by the literature's drop, a wave upstream at about 15 km/h, and no overlaps."""
    count = 60
    x, speed = map(np.asarray, discharge(count, 0.25, 300.0))
    times = 0.25 * np.arange(1, len(x) + 1)
    crossing = np.array([np.interp(0.0, x[:, car], times) for car in range(1, count)])
    headway = np.diff(crossing[10:])  # the queue's first cars pass slowly, the later ones faster
    assert 0.70 * 1836.4 < 3600 / headway.mean() < 0.95 * 1836.4
    assert (headway > 0).all()
    starts = np.array([times[np.argmax(speed[:, car] > 1.0)] for car in range(count)])
    wave = np.polyfit(starts[10:], -7.0 * np.arange(count)[10:], 1)[0]
    assert 12 < -3.6 * wave < 22
    assert (x[:, :-1] - LENGTH - x[:, 1:] > 1.5).all()
    assert (speed >= 0).all()
    # The first car drives as if alone.
    half = 0.5 * CAR["desired_speed"]
    assert np.interp(half, speed[:80, 0], times[:80]) == pytest.approx(12.05897, abs=0.125)


def test_column_settles_at_equilibrium_flow():
    """Behind a leader at 18.77 m/s: gaps s_e, and a lane flow of 1836.4 vehicles an hour."""
    v, count = 18.77, 12
    x = -30.0 * np.arange(count)  # too close at first
    cars = column(x, 15.0, CAR, leader_speed=v)
    x, speed = map(np.asarray, drive(cars, 0.25, 4000))
    np.testing.assert_allclose(speed[-1], v, rtol=1e-3)
    gaps = x[-1, :-1] - LENGTH - x[-1, 1:]
    np.testing.assert_allclose(gaps, equilibrium_gap(CAR, v), rtol=5e-3)
    assert 3600 * v / (gaps.mean() + LENGTH) == pytest.approx(1836.4, rel=5e-3)
    # Counted where they pass: one car each (s_e + L) / v seconds.
    times, line = 0.25 * np.arange(1, 4001), 15_000.0
    passing = np.array([np.interp(line, x[:, car], times) for car in range(count)])
    assert 3600 / np.diff(passing).mean() == pytest.approx(1836.4, rel=5e-3)


@pytest.mark.parametrize(("params", "v"), [(CAR, 25.0), (HIGHWAY, 28.0)])
def test_ring_flow(params, v):
    """On a ring of N (s_e + L) metres a stable column settles to v from unequal gaps and a lower speed."""
    count = 20
    circumference = count * (equilibrium_gap(params, v) + LENGTH)
    rng = np.random.default_rng(0)
    x = circumference / count * (count - np.arange(count)) + rng.uniform(-5, 5, count)
    dt = 0.25

    def tick(carry, _):
        x, speed = carry
        leader = jnp.roll(x, 1) + jnp.where(jnp.arange(count) == 0, circumference, 0.0)
        a = idm_acceleration(speed, leader - LENGTH - x, jnp.roll(speed, 1), **params)
        x, speed = ballistic_step(x, speed, a, dt)
        return (x - v * dt, speed), speed  # the frame moves, so that float32 resolves gaps

    start = jnp.asarray(x, jnp.float32), jnp.full(count, 0.8 * v)
    speed = jax.lax.scan(tick, start, length=8000)[1]
    np.testing.assert_allclose(speed[-1], v, rtol=2e-3)


def test_platoon_members_drive_closer():
    """Cars of one platoon settle at its headway and gap, 0.3 s and 2 m, and others at their own."""
    v = 20.0
    for platoon, params in ((0, CAR | {"time_headway": 0.3}), (NOBODY, CAR)):
        cars = column([0.0, -40.0], v, CAR, platoon, leader_speed=v)
        x, _ = drive(cars, 0.25, 2400)
        gap = float(x[-1, 0] - LENGTH - x[-1, 1])
        assert gap == pytest.approx(equilibrium_gap(params, v), rel=5e-3)


@pytest.mark.parametrize("v", [3.0, 12.0, 22.0, 32.0])
def test_idm_plus_flows_at_its_headway(v):
    """Behind a leader at any lower speed a column settles at s0 + v T: v / (s0 + v T + l) vehicles a second."""
    count, steady = 8, CAR["min_gap"] + v * CAR["time_headway"]
    for start, seconds, tolerance in ((steady, 200, 1e-3), (1.3 * steady, 1000, 1e-2)):
        cars = column(-(LENGTH + start) * np.arange(count), v, CAR, leader_speed=v)
        x, speed = map(np.asarray, drive(cars, 0.25, 4 * seconds, IDM_PLUS))
        np.testing.assert_allclose(speed[-1], v, rtol=tolerance)
        gaps = x[-1, :-1] - LENGTH - x[-1, 1:]
        np.testing.assert_allclose(gaps, steady, rtol=tolerance)
    # Counted where they pass.
    times, line = 0.25 * np.arange(1, len(x) + 1), 0.8 * x[-1, -1]
    passing = np.array([np.interp(line, x[:, car], times) for car in range(count)])
    assert 1 / np.diff(passing).mean() == pytest.approx(v / (steady + LENGTH), rel=0.01)


def test_a_platoon_drives_at_its_leaders_desired_speed():
    """Members with equal desired speeds keep their gaps with IDM+, and fall back with IDM."""
    v, count = 25.0, 3
    gap = 2.0 + 0.3 * v
    for model, keeps in ((IDM_PLUS, True), (STANDARD_IDM, False)):
        same = CAR | {"desired_speed": v}
        cars = column(-(LENGTH + gap) * np.arange(count), v, same, platoon=0)
        x, _ = map(np.asarray, drive(cars, 0.25, 1200, model))
        assert (np.abs(x[-1, :-1] - LENGTH - x[-1, 1:] - gap) < 0.05).all() == keeps
