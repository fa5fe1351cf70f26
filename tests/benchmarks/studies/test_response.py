"""The response surface that tunes a rule, against surfaces of which the top is known."""

import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies.response import GROUP, Responses, directions, fit, step_to_top
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import Budget, budgeted

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_directions_are_opposites_of_spread_one():
    steps = directions(np.random.default_rng(0), groups=200, size=3)
    assert steps.shape == (200, GROUP, 3)
    half = GROUP // 2
    np.testing.assert_array_equal(steps[:, :half], -steps[:, half:])
    np.testing.assert_allclose(steps.std(axis=(0, 1)), 1.0, atol=0.05)


def test_finds_the_top_under_noise_and_luck_of_the_group():
    """Three numbers that depend on one another; what a group has in common is a hundred times what they are worth."""
    rng = np.random.default_rng(1)
    top, bend = (
        np.array([0.5, -0.3, 0.2]),
        np.array([[9.0, 3.0, 0], [3.0, 8.0, 1.0], [0, 1.0, 7.0]]),
    )
    steps = directions(rng, groups=200, size=3)
    away = steps - top
    returns = -0.5 * np.einsum("gki,ij,gkj->gk", away, bend, away)
    returns += 300.0 * rng.standard_normal((200, 1)) + rng.standard_normal(returns.shape)
    slope, curvature, error = fit(steps, returns)
    np.testing.assert_allclose(curvature, -bend, atol=0.3)
    assert (np.abs(slope - bend @ top) < 4.0 * error).all()
    assert (error < 0.1).all()
    np.testing.assert_allclose(step_to_top(slope, curvature), top, atol=0.05)


def test_without_a_top_the_step_is_bounded():
    step = step_to_top(np.array([100.0, -50.0]), np.array([[5.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(step, [1.0, -0.5])


def test_returns_are_those_of_the_evaluation():
    """A rule's numbers, each of a row's own, give what the rule of these numbers scores on that episode."""
    env, params = medjax.make("paper", episode_decisions=40)
    rules = [Budget(), Budget(ramp=(9.0,) * 4)]
    responses = Responses(env, params, budgeted(env), 2 * GROUP)
    rows = np.stack([responses.numbers_of(rule) for rule in rules])
    returns = responses.of(np.broadcast_to(np.tile(rows, (GROUP // 2, 1)), (2, GROUP, 9)), seed=3)
    policies = {str(number): budgeted(env, rule) for number, rule in enumerate(rules)}
    scores = evaluate_policies(env, params, policies, episodes=2, seed=3)
    for number in range(2):
        expected = np.repeat(scores[str(number)]["return"][:, None], GROUP // 2, axis=1)
        np.testing.assert_allclose(returns[:, number::2], expected, atol=0.05)
    assert not np.allclose(returns[:, 0], returns[:, 1])
    found = responses.policy_weights(rows[1])
    np.testing.assert_array_equal(jnp.stack(found.ramp), 9.0)
