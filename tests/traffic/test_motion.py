"""Motion of one tick against closed forms, short float64 steps, and the statistics of the noise."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.following import FREE_GAP_M
from medjax.traffic.motion import (
    Steering,
    heading_difference,
    lateral_step,
    ornstein_uhlenbeck,
    stopping_acceleration,
)
from medjax.world.params import GROUPS, SIZES
from tests.traffic.reference import CAR


def test_ballistic_steps_by_hand():
    """v' = v + a dt, x' = x + v dt + a dt^2 / 2, and the stop rule."""
    v, a, dt, travel, speed = np.float32(
        [
            (20.0, 1.0, 0.25, 5.03125, 20.25),
            (20.0, -8.0, 0.25, 4.75, 18.0),
            (1.0, -4.0, 0.25, 0.125, 0.0),  # stops exactly at the tick's end
            (1.0, -8.0, 0.25, 0.0625, 0.0),  # v^2 / 2|a|, then stands
            (0.0, -3.0, 0.5, 0.0, 0.0),
            (0.0, 2.0, 0.5, 0.25, 1.0),
        ]
    ).T
    x, after = ballistic_step(np.float32(100.0), v, a, dt)
    np.testing.assert_allclose(x, 100.0 + travel, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(after, speed, rtol=0.0, atol=1e-6)


@jax.jit
@functools.partial(jax.grad, argnums=(0, 1))
def ballistic_slopes(v, a, dt):
    return sum(ballistic_step(7.0, v, a, dt))


@settings(max_examples=100)
@given(st.floats(0.0, 60.0), st.floats(-1e4, 5.0), st.floats(0.01, 1.0))
def test_never_reverses(v, a, dt):
    """Whatever the braking: speed stays at 0 or above, and x never falls; slopes are finite."""
    v, a = np.float32(v), np.float32(a)
    x, after = ballistic_step(jnp.float32(7.0), v, a, dt)
    assert after >= 0.0
    assert x >= 7.0
    # The way is that of constant acceleration until it stops.
    time = dt if a >= 0 else min(dt, float(v) / -float(a))
    assert float(x) - 7.0 == pytest.approx(float(v) * time + 0.5 * float(a) * time**2, abs=2e-5)
    assert np.isfinite(ballistic_slopes(v, a, dt)).all()


@pytest.mark.parametrize(
    ("dt", "final_gap", "hardest"), [(0.1, 1.9988, -2.167), (0.5, 2.0000, -2.189)]
)
def test_approach_to_a_wall(dt, final_gap, hardest):
    """From 30 m/s, 500 m ahead; final gap, strongest braking, no reversing."""

    def tick(carry, _):
        x, v = carry
        a = idm_acceleration(v, 500.0 - x, 0.0, **CAR)
        x, v = ballistic_step(x, v, a, dt)
        return (x, v), (x, v, a)

    start = jnp.float32(0.0), jnp.float32(30.0)
    x, v, a = jax.lax.scan(tick, start, length=int(200 / dt))[1]
    assert 500.0 - float(x[-1]) == pytest.approx(final_gap, abs=1.5e-4)
    assert float(a.min()) == pytest.approx(hardest, abs=1e-3)
    assert v.min() >= 0.0
    assert (jnp.diff(x) >= 0.0).all()


@pytest.mark.parametrize("dt", [0.05, 0.25])
def test_free_start_converges_to_the_closed_form(dt):
    """12.05897 s and 101.3543 m to half of v0, with an error that shrinks with dt."""
    steps = int(20 / dt)

    def tick(carry, _):
        x, v = carry
        x, v = ballistic_step(x, v, idm_acceleration(v, FREE_GAP_M, v, **CAR), dt)
        return (x, v), (x, v)

    x, v = jax.lax.scan(tick, (jnp.float32(0.0), jnp.float32(0.0)), length=steps)[1]
    time = np.interp(0.5 * CAR["desired_speed"], v, dt * np.arange(1, steps + 1))
    # Explicit in the speed: behind by half a tick at most where the acceleration falls to zero.
    assert time == pytest.approx(12.05897, abs=0.5 * dt)
    assert np.interp(time, dt * np.arange(1, steps + 1), x) == pytest.approx(101.3543, rel=0.1 * dt)


@pytest.mark.parametrize("dt", [0.05, 0.25, 0.5])
def test_stops_at_the_end_by_constant_braking(dt):
    """A vehicle that brakes no more than it must stops at the end, at b but for the first and the last tick."""
    speed, braking = np.float32(list(itertools.product([3.0, 12.3, 31.0], [2.0, 4.0]))).T
    distance = speed**2 / (2 * braking) + speed * dt + 3.0

    def tick(carry, _):
        x, v = carry
        a = jnp.minimum(0.0, stopping_acceleration(v, distance - x, braking, dt))
        return ballistic_step(x, v, a, dt), a

    (x, v), a = jax.lax.scan(tick, (jnp.zeros(6), jnp.asarray(speed)), length=int(60 / dt))
    assert (v < 1e-3).all()
    assert np.abs(distance - x).max() < 2e-3
    assert (np.asarray(a).min(axis=0) > -braking - 0.01).all()
    for one, hard, start in zip(np.asarray(a).T, braking, speed, strict=True):
        steady = np.flatnonzero(one < -0.98 * hard)
        assert (np.diff(steady) == 1).all()
        assert len(steady) >= start / (hard * dt) - 3


@pytest.mark.thorough
@settings(max_examples=100)
@given(st.floats(0.1, 40.0), st.floats(0.5, 9.0), st.floats(0.05, 0.5), st.floats(1e-3, 500.0))
def test_an_end_beyond_braking_distance_does_not_matter(speed, braking, dt, further):
    """Nobody brakes for it from farther than v^2 / 2b + v dt; closer, everyone does."""
    needed = speed**2 / (2 * braking) + speed * dt
    tolerance = 1e-4 * (1.0 + needed)
    distance = np.float32([needed + tolerance + further, needed - tolerance - further])
    beyond, within = stopping_acceleration(jnp.float32(speed), distance, braking, dt)
    assert beyond > 0.0
    assert within < 0.0


RATE, MOST, ALONG, SLOPE = 2.0, 2.0, 1.5, 0.2  # of steering: 1/s, m/s^2, m/s, and per speed along


@functools.partial(jax.jit, static_argnames="dt")
def steer(start, aim, along, dt):
    def tick(carry, v):
        most = jnp.minimum(ALONG, SLOPE * v)
        carry = lateral_step(*carry, aim, Steering(RATE, MOST, most), dt)
        return carry, jnp.stack(carry)

    return jax.lax.scan(tick, start, along)[1]


def steered(offset, speed, aim, along, dt):
    """(T, 2) offsets and sideways speeds after ticks at speeds along `(T,)`, by the package."""
    start = jnp.float32(offset), jnp.float32(speed)
    path = steer(start, jnp.float32(aim), jnp.asarray(along, jnp.float32), dt)
    return np.asarray(path, np.float64)


def exactly_steered(offset, speed, aim, limit, seconds, dt=1e-3):
    """(T, 2) of the same law in short float64 steps: w' = 2 r (wanted - w), both within their limits."""
    path, y, w = [], offset, speed
    for _ in range(round(seconds / dt)):
        wanted = np.clip(0.5 * RATE * (aim - y), -limit, limit)
        a = np.clip(2.0 * RATE * (wanted - w), -MOST, MOST)
        y, w = y + (w + 0.5 * a * dt) * dt, w + a * dt
        path.append((y, w))
    return np.array(path)


@pytest.mark.parametrize("along", [30.0, 5.0, 1.0])
@pytest.mark.parametrize(
    ("offset", "speed", "aim"), [(4.0, 0.0, 0.0), (-4.0, 0.2, 0.3), (0.0, -0.2, -0.1)]
)
def test_steering_solves_its_equation(offset, speed, aim, along):
    """Against the saturated law in float64: off by 0.5 m/s times the tick, which falls with the tick."""
    exact = exactly_steered(offset, speed, aim, min(ALONG, SLOPE * along), 6.0)
    for dt in (0.25, 0.125, 0.025):
        every = round(dt / 1e-3)
        path = steered(offset, speed, aim, np.full(round(6.0 / dt), along), dt)
        assert np.abs(path - exact[every - 1 :: every])[:, 0].max() < 0.5 * dt


def test_without_limits_steering_is_critically_damped():
    """y'' = -r^2 y - 2 r y' from rest: (1 + r t) exp(-r t), where neither limit is reached."""
    dt = 0.005
    path = steered(0.2, 0.0, 0.0, np.full(800, 30.0), dt)
    t = dt * np.arange(1, 801)
    np.testing.assert_allclose(path[:, 0], 0.2 * (1 + RATE * t) * np.exp(-RATE * t), atol=1e-3)


@pytest.mark.parametrize("acceleration", [0.5, MOST, 20.0])
def test_the_stiffest_steering_settles(acceleration):
    """At the highest rate and the longest tick, an offset of a lane's width dies out."""
    rate, dt = GROUPS["motion"]["lateral_rate"].high, SIZES["tick_s"].high
    steering = Steering(rate, acceleration, ALONG)

    def tick(carry, _):
        carry = lateral_step(*carry, 0.0, steering, dt)
        return carry, carry[0]

    start = jnp.float32(4.0), jnp.float32(0.0)
    offset = np.asarray(jax.lax.scan(tick, start, length=240)[1])
    assert np.abs(offset[-40:]).max() < 1e-3


@pytest.mark.parametrize("dt", [0.05, 0.125, 0.25, 0.5])
def test_a_lane_change_takes_three_to_five_seconds(dt):
    """To 5 % of the lane's width; the literature's mean is 4.6 s (Toledo, Zohar 2007)."""
    for along in (20.0, 25.0, 33.0):
        path = steered(4.0, 0.0, 0.0, np.full(round(10 / dt), along), dt)
        assert 3.0 <= dt * (1 + np.argmax(path[:, 0] < 0.2)) <= 5.0
        assert np.abs(path[-1]).max() < 1e-2
        assert path[:, 0].min() > -1e-3


@settings(max_examples=100)
@given(
    st.floats(-4.2, 4.2),
    st.floats(-0.3, 0.3),
    st.lists(st.sampled_from([-9.0, -4.0, -1.0, 0.0, 1.4]), min_size=5, max_size=5),
    st.floats(0.0, 35.0),
    st.sampled_from([0.05, 0.25, 0.5]),
)
def test_steering_is_comfortable_and_stops_with_the_vehicle(offset, aim, pedal, along, dt):
    """Sideways at most 2 m/s^2 and min(1.5 m/s, a fifth of the speed along); it never moves beyond the aim."""
    speeds = np.maximum(along + dt * np.cumsum(np.repeat(pedal, round(2.0 / dt))), 0.0)
    path = steered(offset, 0.0, aim, speeds, dt)
    w = np.append(0.0, path[:, 1])
    assert np.abs(np.diff(w)).max() <= MOST * dt + 1e-6
    assert (np.abs(w[1:]) <= np.minimum(ALONG, SLOPE * speeds) + 1e-6).all()
    stands = (speeds[1:] == 0.0) & (speeds[:-1] == 0.0)
    np.testing.assert_array_equal(np.diff(path[:, 0])[stands], 0.0)
    beyond = np.sign(offset - aim) * (aim - path[:, 0])
    assert beyond.max() < 1e-3


def test_turn_is_the_difference_of_headings():
    """Against atan2 in float64, for all speeds and turns of driving; a crawling vehicle does not turn."""
    rng = np.random.default_rng(0)
    speed, other = rng.uniform(0.0, 35.0, (2, 100_000)).astype(np.float32)
    aside, other_aside = rng.normal(0.0, 1.0, (2, 100_000)).astype(np.float32)
    ours = np.asarray(heading_difference(speed, aside, other, other_aside), np.float64)

    def heading(speed, aside):
        return np.arctan2(aside.astype(np.float64), np.maximum(speed.astype(np.float64), 1.0))

    exact = np.clip(heading(other, other_aside) - heading(speed, aside), -np.pi / 2, np.pi / 2)
    np.testing.assert_allclose(ours, exact, atol=1e-6)
    assert float(heading_difference(0.0, 0.0, 25.0, 1.0)) == pytest.approx(np.arctan(0.04))
    assert float(heading_difference(0.0, 0.0, 0.0, 0.0)) == 0.0


@pytest.mark.parametrize(
    ("std", "time_s", "dt"), [(0.15, 5.0, 1.0), (2.0, 5.0, 0.25), (1.0, 1.0, 3.0)]
)
def test_ornstein_uhlenbeck_statistics(std, time_s, dt):
    """From a stationary start it keeps mean 0 and std, and forgets as exp(-t / time)."""
    walkers, steps = 20_000, 8
    draws = jax.random.normal(jax.random.key(3), (steps + 1, walkers))

    def step(value, normal):
        value = ornstein_uhlenbeck(value, normal, std, time_s, dt)
        return value, value

    path = np.asarray(jax.lax.scan(step, std * draws[0], draws[1:])[1], np.float64)
    error = std / np.sqrt(walkers)
    assert abs(path[-1].mean()) < 4 * error
    assert path[-1].std() == pytest.approx(std, abs=4 * error / np.sqrt(2))
    for lag in (1, 3, 6):
        correlation = np.corrcoef(path[0], path[lag])[0, 1]
        assert correlation == pytest.approx(np.exp(-lag * dt / time_s), abs=4 / np.sqrt(walkers))


def test_ornstein_uhlenbeck_from_rest():
    """From 0 the variance grows as std^2 (1 - exp(-2 t / time))."""
    draws = jax.random.normal(jax.random.key(4), (20_000,))
    after = ornstein_uhlenbeck(jnp.zeros(20_000), draws, 0.5, 5.0, 2.0)
    expected = 0.5 * np.sqrt(1 - np.exp(-2 * 2.0 / 5.0))
    assert float(after.std()) == pytest.approx(expected, rel=4 / np.sqrt(2 * 20_000))
