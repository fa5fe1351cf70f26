"""`DecideEvery` against the same decisions one by one."""

import chex
import jax
import jax.numpy as jnp
import pytest

from medjax.wrappers import DecideEvery
from tests.train.probe_envs import Probe, ProbeParams


def one_by_one(env, interval, key, state, action, params):
    """Reference of a step, which stops where the episode ends, and its number of decisions."""
    total, count = 0.0, 0
    for index, own in enumerate(jax.random.split(key, interval)):
        chosen = jnp.int32(action if index == 0 else 0)
        obs, state, reward, terminated, truncated, info = env.step_env(own, state, chosen, params)
        total, count = total + reward, count + 1
        if terminated or truncated:
            break
    return (obs, state, total, terminated, truncated, info), count


@pytest.mark.parametrize(
    ("kind", "interval", "expected"),
    [
        ("noisy", 1, [1, 1, 1, 1, 1]),
        ("noisy", 2, [2, 2, 1]),
        ("noisy", 5, [5]),
        ("noisy", 8, [5]),
        ("two_step", 8, [2]),
        ("follow", 3, [1]),
    ],
)
def test_a_step_is_the_decisions_until_the_next_choice_or_the_end(kind, interval, expected):
    """Episodes of 5, 2 and 1 decisions; noisy rewards action 1, which only the first decision takes."""
    env, params = Probe(kind), ProbeParams()
    wrapped = DecideEvery(env, interval)
    obs, state = jax.jit(wrapped.reset)(jax.random.key(1), params)
    chex.assert_trees_all_equal((obs, state), jax.jit(env.reset)(jax.random.key(1), params))
    step = jax.jit(wrapped.step_env)
    counts = []
    for number in range(len(expected)):
        key = jax.random.fold_in(jax.random.key(2), number)
        right, count = one_by_one(env, interval, key, state, 1, params)
        result = step(key, state, jnp.int32(1), params)
        chex.assert_trees_all_close(result, right, rtol=1e-6)
        chex.assert_trees_all_equal_dtypes(result, right)
        counts.append(count)
        state = result[1]
    assert counts == expected
    assert bool(result[3] | result[4])  # the episode is over, and not before
    assert int(state.time) == sum(expected)
