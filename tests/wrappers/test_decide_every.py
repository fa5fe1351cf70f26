"""A policy that chooses now and then."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.wrappers import DecideEvery, choices
from tests.train.probe_envs import Probe, ProbeParams


def test_only_every_third_decision_leaves_a_choice_and_what_is_forbidden_stays_so():
    allowed = jnp.array([True, True, False])
    seen = jax.vmap(choices, (None, 0, None))(allowed, jnp.arange(7), 3)
    expected = [[True, time % 3 == 0, False] for time in range(7)]
    np.testing.assert_array_equal(seen, expected)


def test_the_environment_itself_is_left_alone():
    """Observations and rewards are those of the environment; its clock counts on between choices."""
    env, params = Probe("follow"), ProbeParams()
    wrapped = DecideEvery(env, 2)
    key = jax.random.key(1)
    (obs, state), (plain_obs, plain) = wrapped.reset(key, params), env.reset(key, params)
    for time in range(4):
        np.testing.assert_array_equal(obs, plain_obs)
        np.testing.assert_array_equal(
            wrapped.action_mask(state, params), [True, True] if time % 2 == 0 else [True, False]
        )
        obs, state, reward, *_ = wrapped.step_env(key, state, jnp.int32(1), params)
        plain_obs, plain, plain_reward, *_ = env.step_env(key, plain, jnp.int32(1), params)
        assert reward == plain_reward


def test_bad_interval_is_refused():
    with pytest.raises(ValueError, match="interval is 0, must be at least 1"):
        DecideEvery(Probe("follow"), 0)
