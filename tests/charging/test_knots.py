"""In the preset, no vehicle waits for a MED, and bookings make no EV brake hard."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.invariants import stands_open

pytestmark = pytest.mark.usefixtures("quick_compiles")

# `python -m benchmarks.soak` checks the same in random worlds.
EPISODES, DECISIONS = 4, 600


@pytest.fixture(scope="module")
def probed():
    """The preset with a probe of speeds, bookings and presence."""
    env, params = medjax.make("paper")

    def probe(state):
        return state.vehicles.speed, state.evs.med, state.vehicles.active

    return env.with_probe(probe), params


@functools.partial(jax.jit, static_argnums=(0, 2, 4))
def play(env, params, rule, keys, decisions):
    """Longest time that a vehicle stood on an open road, `(episodes,)` s, and the probe's values by tick."""
    policy = medjax.BASELINES[rule](env)

    def episode(key):
        reset_key, key = jax.random.split(key)
        _, state = env.reset(reset_key, params)

        def step(carry, key):
            state, stood = carry
            action = policy(key, None, state, params).action
            _, after, *_, info = env.step_env(key, state, action, params)
            open_road = [stands_open(each, env.config, params) for each in (state, after)]
            stood = jnp.where(open_road[0] & open_road[1], stood + env.config.decision_s, 0.0)
            return (after, stood), (stood.max(), info["ticks"])

        start = state, jnp.zeros((env.config.num_vehicles,))
        _, (stood, seen) = jax.lax.scan(step, start, jax.random.split(key, decisions))
        return stood.max(), jax.tree.map(lambda each: each.reshape(-1, each.shape[-1]), seen)

    return jax.lax.map(episode, keys, batch_size=25)


@pytest.mark.parametrize(
    "rule",
    [
        pytest.param("paced", marks=pytest.mark.slow),
        pytest.param("greedy", marks=pytest.mark.thorough),
    ],
)
def test_no_booking_makes_an_ev_brake_hard(probed, rule):
    """In the 3 s after a booking begins or ends EVs brake at less than 3 m/s2, but for one in two hundred."""
    env, params = probed
    config, keys = env.config, jax.random.split(jax.random.key(5), EPISODES)
    stood, (speed, med, active) = jax.device_get(play(env, params, rule, keys, DECISIONS))
    assert stood.max() == 0.0  # on an open road
    ticks = round(3.0 / config.tick_s)
    speed, active = (each[..., config.ev_slots] for each in (speed, active))
    there = active[:, 1:] & active[:, :-1]
    braking = np.where(there, np.diff(speed, axis=1) / config.tick_s, 0.0)
    changes = np.argwhere((np.diff(med, axis=1) != 0) & there)
    worst = [braking[b, t : t + ticks, e].min() for b, t, e in changes]
    assert len(worst) > 100
    assert np.mean(np.array(worst) < -3.0) <= 0.005


@pytest.mark.slow
@pytest.mark.parametrize("rule", medjax.BASELINES)
def test_no_vehicle_stands_on_an_open_road(rule):
    """In 100 episodes of any rule no vehicle with energy stands from one second to the next with 60 m free ahead."""
    env, params = medjax.make("paper")
    keys = jax.random.split(jax.random.key(5), 100)
    stood, _ = play(env, params, rule, keys, int(params.episode_decisions))
    assert jnp.max(stood) == 0.0
