"""A policy is a function that JAX compiles, and an argument of compiled programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.policies.policy import Choice, Policy, every, sampled


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


def test_a_sampled_policy_draws_actions_as_often_as_their_probabilities_say(prefers):
    """Of 20,000 draws each count is within five standard deviations; a rule's choice is never another."""
    keys = jax.random.split(jax.random.key(3), 20_000)
    draws = jax.jit(jax.vmap(sampled(prefers), (0, None, None, None)))(keys, 1.0, None, None)
    counts = np.bincount(draws.action, minlength=3)
    chances = np.asarray(prefers(keys[0], 1.0, None, None).probabilities, np.float64)
    np.testing.assert_array_less(
        abs(counts - 20_000 * chances), 5 * np.sqrt(20_000 * chances * (1 - chances))
    )
    np.testing.assert_allclose(draws.probabilities[0], chances, rtol=1e-6)
    certain = prefers.replace(weights={"bias": jnp.array([0.0, 1000.0, 0.0])})
    drawn = jax.vmap(sampled(certain), (0, None, None, None))(keys[:100], 1.0, None, None)
    assert set(np.asarray(drawn.action)) == {1}


def test_a_sampled_policy_that_is_asked_rarely_waits_in_between(prefers):
    class Clock:
        time = 1

    choice = sampled(every(prefers, 2))(jax.random.key(0), 1.0, Clock, None)
    assert int(choice.action) == 0


def test_new_weights_do_not_compile_again(prefers):
    traces = []

    @jax.jit
    def chooses(policy):
        traces.append(policy)
        return policy(jax.random.key(0), 1.0, None, None).action

    assert int(chooses(prefers)) == 1
    assert int(chooses(prefers.replace(weights={"bias": jnp.array([5.0, 3.0, 2.0])}))) == 0
    assert len(traces) == 1
