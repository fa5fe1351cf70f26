"""Roads that several tests play on, compiled once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.traffic.roads import run

import medjax

MAINLINE_PER_H = np.array([800.0, 2800.0, 2800.0, 4500.0, 4500.0, 8000.0], np.float32)


@pytest.fixture(scope="package")
def quiet():
    """A road that nobody enters by himself, on which only what must change lanes does.

    The threshold outweighs any gain of a free choice (at most 1.4 m/s^2 from a standing start plus
    what safe braking saves), the mandatory bias outweighs the threshold.
    """
    return medjax.make(
        "paper", mainline_per_h=0.0, ramp_per_h=0.0, threshold=15.0, mandatory_bias=40.0
    )


@pytest.fixture(scope="package")
def blank(quiet):
    """A state of it, to be filled with `put`."""
    env, params = quiet
    return jax.jit(env.reset)(jax.random.key(0), params)[1]


@pytest.fixture(scope="package")
def play(quiet):
    """150 s of `physics_tick`."""
    return run(quiet[0].config, 600)


@pytest.fixture(scope="package")
def each_tick():
    """The paper's road with one tick a decision: `step_env` then shows every tick."""
    return medjax.make("paper", ticks_per_decision=1)


@pytest.fixture(scope="package")
def random_play(each_tick):
    """States (roads, ticks, ...) of six roads under random actions, from empty to jammed, 300 s."""
    env, params = each_tick

    @jax.jit
    @jax.vmap
    def go(key, mainline):
        busy = params.replace(demand=params.demand.replace(mainline_per_h=mainline))
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key, busy)[1]

        def step(state, key):
            action_key, key = jax.random.split(key)
            action = jax.random.randint(action_key, (), 0, env.num_actions)
            state = env.step_env(key, state, action, busy)[1]
            return state, state

        return jax.lax.scan(step, start, jax.random.split(key, 1200))[1]

    keys = jax.random.split(jax.random.key(7), len(MAINLINE_PER_H))
    return go(keys, jnp.asarray(MAINLINE_PER_H))
