"""Motion of one tick against closed forms, an ODE solver, and the statistics of the noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from medjax.traffic import ballistic_step, idm_acceleration
from medjax.traffic.following import FREE_GAP_M
from medjax.traffic.motion import lateral_step, ornstein_uhlenbeck, turn_between
from tests.traffic.reference import CAR, idm


@pytest.mark.parametrize(
    ("v", "a", "dt", "travel", "speed"),
    [
        (20.0, 1.0, 0.25, 5.03125, 20.25),
        (20.0, -8.0, 0.25, 4.75, 18.0),
        (1.0, -4.0, 0.25, 0.125, 0.0),  # stops exactly at the tick's end
        (1.0, -8.0, 0.25, 0.0625, 0.0),  # v^2 / 2|a|, then stands
        (0.0, -3.0, 0.5, 0.0, 0.0),
        (0.0, 2.0, 0.5, 0.25, 1.0),
    ],
)
def test_item_8(v, a, dt, travel, speed):
    """v' = v + a dt, x' = x + v dt + a dt^2 / 2, and the stop rule."""
    x, after = ballistic_step(jnp.float32(100.0), jnp.float32(v), jnp.float32(a), dt)
    assert float(x) == pytest.approx(100.0 + travel, abs=1e-5)
    assert float(after) == pytest.approx(speed, abs=1e-6)


@settings(max_examples=100, deadline=None)
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
    slope = jax.grad(lambda v, a: sum(ballistic_step(7.0, v, a, dt)), argnums=(0, 1))(v, a)
    assert np.isfinite(slope).all()


@pytest.mark.parametrize(
    ("dt", "final_gap", "hardest"), [(0.1, 1.9988, -2.167), (0.5, 2.0000, -2.189)]
)
def test_approach_to_a_wall(dt, final_gap, hardest):
    """Item 5: from 30 m/s, 500 m ahead; final gap, strongest braking, no reversing."""

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
def test_free_start_converges_to_item_3(dt):
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


@pytest.mark.parametrize("dt", [0.02, 0.25, 0.5])
@pytest.mark.parametrize(
    ("offset", "speed", "aim"), [(4.0, 0.0, 0.0), (-4.0, 1.0, 0.3), (0.0, -2.0, -0.1)]
)
def test_lateral_relaxation_solves_its_ode(dt, offset, speed, aim):
    """Ten steps of any size against y'' = -r^2 (y - aim) - 2 r y' in float64."""
    rate = 2.0

    def ode(_, y):
        return [y[1], -(rate**2) * (y[0] - aim) - 2 * rate * y[1]]

    exact = solve_ivp(ode, (0, 10 * dt), (offset, speed), rtol=1e-10, atol=1e-12).y[:, -1]
    y, w = jnp.float32(offset), jnp.float32(speed)
    for _ in range(10):
        y, w = lateral_step(y, w, jnp.float32(aim), rate, dt)
    np.testing.assert_allclose([y, w], exact, atol=5e-6)


def test_lane_change_takes_two_to_four_seconds():
    """95 % of one lane, the literature's span, at the preset's rate; never past the aim."""
    times = jnp.arange(0.0, 8.0, 0.05)
    y = jax.vmap(lambda t: lateral_step(jnp.float32(4.0), jnp.float32(0.0), 0.0, 2.0, t)[0])(times)
    assert 2.0 <= times[jnp.argmax(y < 0.05 * 4.0)] <= 4.0
    assert (y > 0).all()


def test_turn_is_the_difference_of_headings():
    """Against atan2 in float64, for all speeds and turns that driving knows; a crawl turns nobody."""
    rng = np.random.default_rng(0)
    speed, other = rng.uniform(0.0, 35.0, (2, 100_000)).astype(np.float32)
    aside, other_aside = rng.normal(0.0, 1.0, (2, 100_000)).astype(np.float32)
    ours = np.asarray(turn_between(speed, aside, other, other_aside), np.float64)

    def heading(speed, aside):
        return np.arctan2(aside.astype(np.float64), np.maximum(speed.astype(np.float64), 1.0))

    exact = np.clip(heading(other, other_aside) - heading(speed, aside), -np.pi / 2, np.pi / 2)
    np.testing.assert_allclose(ours, exact, atol=1e-6)
    assert float(turn_between(0.0, 0.0, 25.0, 1.0)) == pytest.approx(np.arctan(0.04))
    assert float(turn_between(0.0, 0.0, 0.0, 0.0)) == 0.0


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


def test_reference_idm_is_the_printed_one():
    """The float64 version that other tests lean on gives item 1's first number."""
    assert idm(CAR, 40.0, 25.0, 20.0) == pytest.approx(-4.210771, abs=5e-7)
