"""A policy is a function that JAX compiles, and an argument of compiled programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.policies.policy import Choice, Policy


@pytest.fixture
def prefers():
    """Prefers the action with the largest weight."""

    def act(weights, key, obs, state, params):
        chances = jax.nn.softmax(weights["bias"] * obs)
        return Choice(jnp.argmax(chances), chances)

    return Policy(act, {"bias": jnp.array([1.0, 3.0, 2.0])})


def test_a_policy_can_be_jitted_and_batched(prefers):
    """Although its weights have no hash."""
    alone = jax.jit(prefers)(jax.random.key(0), 1.0, None, None)
    assert int(alone.action) == 1
    both = jax.jit(jax.vmap(prefers, (None, 0, None, None)))(
        jax.random.key(0), jnp.array([1.0, -1.0]), None, None
    )
    np.testing.assert_array_equal(both.action, [1, 0])


def test_new_weights_do_not_compile_again(prefers):
    traces = []

    @jax.jit
    def chooses(policy):
        traces.append(policy)
        return policy(jax.random.key(0), 1.0, None, None).action

    assert int(chooses(prefers)) == 1
    assert int(chooses(prefers.replace(weights={"bias": jnp.array([5.0, 3.0, 2.0])}))) == 0
    assert len(traces) == 1
