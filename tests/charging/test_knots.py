"""On the preset's road nobody waits for a MED, and a booking makes nobody brake hard."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.verification.invariants import STANDS_S, stands_open

# Of every rule that sends MEDs; `python -m benchmarks.soak` has the same in random worlds.
EPISODES, DECISIONS = 4, 600


@pytest.fixture(scope="module")
def played():
    """Longest time that anyone stood on an open road, s, by rule; and the hardest braking after bookings change."""
    env, params = medjax.make("paper")
    config = env.config
    probed = env.with_probe(
        lambda state: (state.vehicles.speed, state.evs.med, state.vehicles.active)
    )

    def episode(policy, key):
        reset_key, key = jax.random.split(key)
        _, state = env.reset(reset_key, params)

        def step(carry, key):
            state, stood = carry
            action = policy(key, None, state, params).action
            _, after, *_, info = probed.step_env(key, state, action, params)
            stands = stands_open(state, config, params) & stands_open(after, config, params)
            stood = jnp.where(stands, stood + config.decision_s, 0.0)
            return (after, stood), (stood.max(), info["ticks"])

        start = state, jnp.zeros((config.num_vehicles,))
        return jax.lax.scan(step, start, jax.random.split(key, DECISIONS))[1]

    keys = jax.random.split(jax.random.key(5), EPISODES)
    results = {}
    for name in ("paced", "greedy"):
        policy = medjax.BASELINES[name](env)
        results[name] = jax.device_get(
            jax.jit(lambda keys, policy=policy: jax.lax.map(lambda k: episode(policy, k), keys))(
                keys
            )
        )
    return config, results


def test_nobody_stands_on_an_open_road(played):
    """No vehicle with energy stands for 5 s with 60 m free ahead of it."""
    for _, (stood, _) in played[1].items():
        assert stood.max() <= STANDS_S


def test_no_booking_makes_an_ev_brake_hard(played):
    """In the 3 s after a booking begins or ends EVs brake at less than 3 m/s2, but for one in two hundred."""
    config, results = played
    ticks = round(3.0 / config.tick_s)
    for _, (speed, med, active) in (ticks_of(result) for result in results.values()):
        speed, active = (each[..., config.ev_slots] for each in (speed, active))
        there = active[:, 1:] & active[:, :-1]
        braking = np.where(there, np.diff(speed, axis=1) / config.tick_s, 0.0)
        changes = np.argwhere((np.diff(med, axis=1) != 0) & there)
        worst = [braking[b, t : t + ticks, e].min() for b, t, e in changes]
        assert len(worst) > 100
        assert np.mean(np.array(worst) < -3.0) <= 0.005


def ticks_of(result):
    """How long anyone stood; and arrays `(episodes, ticks, ...)`."""
    stood, seen = result
    return stood, [each.reshape(EPISODES, -1, each.shape[-1]) for each in seen]
