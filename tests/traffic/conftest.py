"""Roads that several tests play on, compiled once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from tests.traffic.roads import run

# The numbers that tests here compute with. Kinds are MED, human EV, autonomous EV, gas vehicle, lorry (none come).
FIXED = {
    "length_m": 4000.0,
    "ramp_x_m": [100.0, 1200.0, 2100.0, 3200.0],
    "acceleration_lane_m": 250.0,
    "desired_speed": [25.0, 30.0, 30.0, 30.0, 24.0],
    "desired_speed_std": [0.0, 2.0, 1.0, 2.0, 1.0],
    "time_headway": [2.0, 1.5, 1.5, 1.5, 2.0],
    "min_gap": [4.0, 2.0, 2.0, 2.0, 4.0],
    "max_acceleration": [1.0, 1.4, 1.4, 1.4, 0.5],
    "comfortable_deceleration": 2.0,
    "vehicle_length": [12.0, 5.0, 5.0, 5.0, 16.5],
    "safe_braking": 4.0,
    "max_braking": 9.0,
    "politeness": 0.2,
    "service_lane": 2,
    "ev_share": 0.3,
}
MAINLINE_PER_H = np.array([800.0, 2800.0, 2800.0, 4500.0, 4500.0, 8000.0], np.float32)


@pytest.fixture(scope="package")
def quiet():
    """A road without demand, on which vehicles change lanes only if they must.

    The threshold outweighs any gain of a free choice, the mandatory bias outweighs the threshold.
    """
    none = {"mainline_per_h": 0.0, "ramp_per_h": 0.0}
    return medjax.make("paper", threshold=15.0, mandatory_bias=40.0, **none, **FIXED)


@pytest.fixture(scope="package")
def asked():
    """A road on which 2800 vehicles an hour ask to enter at the left end, and 300 at each ramp."""
    return medjax.make("paper", mainline_per_h=2800.0, ramp_per_h=300.0, **FIXED)


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
    """The preset with one tick a decision, so that `step_env` shows every tick, and merging all the time."""
    return medjax.make("paper", ticks_per_round=1, ramp_per_h=600.0, cooldown_s=20.0)


@pytest.fixture(scope="package")
def play_randomly(each_tick):
    """(keys, mainline demands, params) -> states (roads, ticks, ...) of 300 s under random actions."""
    env, _ = each_tick

    def go(key, mainline, params):
        params = params.replace(demand=params.demand.replace(mainline_per_h=mainline))
        reset_key, key = jax.random.split(key)
        start = env.reset(reset_key, params)[1]

        def step(state, key):
            action_key, key = jax.random.split(key)
            action = jax.random.randint(action_key, (), 0, env.num_actions)
            state = env.step_env(key, state, action, params)[1]
            return state, state

        return jax.lax.scan(step, start, jax.random.split(key, 1200))[1]

    return jax.jit(jax.vmap(go, (0, 0, None)))


@pytest.fixture(scope="package")
def random_play(each_tick, play_randomly):
    """Six roads from empty to jammed."""
    keys = jax.random.split(jax.random.key(7), len(MAINLINE_PER_H))
    return play_randomly(keys, jnp.asarray(MAINLINE_PER_H), each_tick[1])
