"""The five-value step under a rollout in PureJaxRL's manner, against gymnax 1.0's step."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

import medjax
from medjax.wrappers import LegacyStep

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS = 4
NUM_ENVS, NUM_STEPS = 3, 6


@struct.dataclass
class LogState:
    env_state: Any
    episode_return: jax.Array
    returned_episode_return: jax.Array


class Log:
    """A logger as such code brings along: it forwards what it does not know and reads one flag."""

    def __init__(self, env):
        self._env = env

    def __getattr__(self, name):
        return getattr(self._env, name)

    def reset(self, key, params=None):
        obs, state = self._env.reset(key, params)
        return obs, LogState(state, jnp.float32(0.0), jnp.float32(0.0))

    def step(self, key, state, action, params=None):
        obs, env_state, reward, done, info = self._env.step(key, state.env_state, action, params)
        total = state.episode_return + reward
        state = LogState(
            env_state=env_state,
            episode_return=total * (1 - done),
            returned_episode_return=jnp.where(done, total, state.returned_episode_return),
        )
        info["returned_episode_returns"] = state.returned_episode_return
        info["returned_episode"] = done
        return obs, state, reward, done, info


@pytest.fixture(scope="module")
def world():
    return medjax.make(
        "paper",
        num_meds=3,
        num_evs=8,
        num_gas=12,
        mainline_per_h=600.0,
        episode_decisions=DECISIONS,
    )


@pytest.fixture(scope="module")
def rollout(world, quick_compiles):
    """(dones, rewards, infos, keys, actions), each (NUM_STEPS, NUM_ENVS, ...)."""
    base, params = world
    env = Log(LegacyStep(base))

    @jax.jit
    def play(key):
        key, reset_key = jax.random.split(key)
        _, state = jax.vmap(env.reset, in_axes=(0, None))(
            jax.random.split(reset_key, NUM_ENVS), params
        )

        def env_step(carry, _):
            state, key = carry
            key, act_key, step_key = jax.random.split(key, 3)
            shape = (NUM_ENVS, env.action_space(params).n)
            action = jax.random.categorical(act_key, jnp.zeros(shape))
            keys = jax.random.split(step_key, NUM_ENVS)
            obs, state, reward, done, info = jax.vmap(env.step, in_axes=(0, 0, 0, None))(
                keys, state, action, params
            )
            return (state, key), (obs, reward, done, info, keys, action)

        return jax.lax.scan(env_step, (state, key), None, NUM_STEPS)[1]

    return play(jax.random.key(1))


def test_returns_are_logged_where_an_episode_is_done(rollout):
    _, rewards, dones, infos, _, _ = rollout
    assert dones.shape == (NUM_STEPS, NUM_ENVS)
    assert dones.dtype == bool
    assert np.flatnonzero(dones.all(axis=1)).tolist() == [DECISIONS - 1]
    assert dones.sum() == NUM_ENVS
    logged = infos["returned_episode_returns"][DECISIONS - 1]
    np.testing.assert_allclose(logged, rewards[:DECISIONS].sum(axis=0), rtol=1e-5)


def test_info_keeps_what_the_flag_loses(rollout):
    obs, _, dones, infos, _, _ = rollout
    np.testing.assert_array_equal(infos["truncated"], dones)
    assert not infos["terminated"].any()
    last = np.asarray(infos["final_observation"])
    going_on = ~np.asarray(dones)
    np.testing.assert_array_equal(last[going_on], obs[going_on])
    assert (last[DECISIONS - 1] != obs[DECISIONS - 1]).any(axis=1).all()


class Ends:
    """An environment of which only the two flags matter; the action says which."""

    name, num_actions = "ends", 4

    def step(self, key, state, action, params):
        return "obs", "state", "reward", action // 2 == 1, action % 2 == 1, {"why": "flags"}


@pytest.mark.parametrize("action", range(4))
def test_done_is_either_flag(action):
    *values, done, info = LegacyStep(Ends()).step(None, None, action, None)
    assert values == ["obs", "state", "reward"]
    assert done == (action > 0)
    assert info == {"why": "flags", "terminated": action // 2 == 1, "truncated": action % 2 == 1}


def test_the_rest_is_that_of_the_environment(world):
    env, params = world
    legacy = LegacyStep(env)
    assert (legacy.name, legacy.num_actions) == (env.name, env.num_actions)
    assert legacy.observation_space(params) == env.observation_space(params)
    assert legacy.action_space(params) == env.action_space(params)
