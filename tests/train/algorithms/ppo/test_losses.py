"""The objective of eq. (9), its gradient, and what goes into it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from train.algorithms.networks import masked_categorical
from train.algorithms.ppo.losses import (
    Batch,
    clipped_surrogate,
    explained_variance,
    ppo_loss,
    standardize,
    value_loss,
    weigh,
)
from train.algorithms.ppo.settings import PPOConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

EPS = 0.2


def test_gradient_is_zero_exactly_where_the_ratio_is_clipped():
    """Beyond 1 + eps at a positive advantage, and below 1 - eps at a negative one."""
    ratio = np.array([[0.1, 0.5, 0.79, 0.81, 0.99, 1.01, 1.19, 1.21, 2.0, 10.0]], np.float32)
    advantage = np.array([[-2.0], [-0.5], [0.5], [2.0]], np.float32)
    log_prob = jnp.log(jnp.broadcast_to(ratio, (4, 10)))
    total = lambda log_prob: clipped_surrogate(log_prob, 0.0, advantage, EPS).sum()  # noqa: E731
    clipped = np.where(advantage > 0, ratio > 1 + EPS, ratio < 1 - EPS)
    expected = np.where(clipped, 0.0, ratio * advantage)  # d ratio / d log_prob = ratio
    gradient = jax.grad(total)(log_prob)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=0.0)


def test_surrogate_is_the_minimum_of_the_two_terms():
    rng = np.random.default_rng(0)
    new, old, advantage = rng.normal(size=(3, 500))
    ratio = np.exp(new - old)
    expected = np.where(
        advantage > 0,
        np.minimum(ratio, 1 + EPS) * advantage,
        np.maximum(ratio, 1 - EPS) * advantage,
    )
    got = clipped_surrogate(*(jnp.asarray(x, jnp.float32) for x in (new, old, advantage)), EPS)
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-6)


def test_value_loss():
    value, old, target = jnp.array([[1.0, 1.0, 0.0], [0.0, 0.9, 0.0], [2.0, 2.0, 2.0]])
    np.testing.assert_allclose(value_loss(value, old, target, None), [0.5, 0.5, 2.0])
    # The first kept within 0.2 of the old value: 0.5 (0.2 - 2)^2.
    np.testing.assert_allclose(value_loss(value, old, target, 0.2), [1.62, 0.5, 2.0], rtol=1e-6)


def test_standardize():
    x = np.random.default_rng(0).normal(3.0, 5.0, (7, 9))
    for some in (np.ones((7, 9), bool), np.random.default_rng(1).random((7, 9)) < 0.3):
        expected = (x - x[some].mean()) / x[some].std()
        got = standardize(jnp.asarray(x), jnp.asarray(some / some.mean(), jnp.float32))
        np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)
    assert np.isfinite(standardize(jnp.ones(4), jnp.ones(4))).all()
    assert np.isfinite(standardize(jnp.ones(4), jnp.zeros(4))).all()


@pytest.mark.thorough
def test_policy_and_value_learn_only_where_they_have_a_weight():
    rng = np.random.default_rng(2)
    logits, value = (jnp.asarray(rng.normal(size=shape), jnp.float32) for shape in ((6, 3), (6,)))
    mask = jnp.ones((6, 3), bool).at[3:, 1:].set(False)
    batch = Batch(
        action=jnp.array([0, 1, 2, 0, 0, 0]),
        log_prob=jnp.array([-1.0, -1.0, -1.0, 0.0, 0.0, 0.0]),
        value=value,
        advantage=jnp.asarray(rng.normal(size=6), jnp.float32),
        target=value + 1.0,
        weight=jnp.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
        value_weight=jnp.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]),
    )
    config = PPOConfig(clip_epsilon=EPS, value_coef=0.5, entropy_coef=0.01, clip_value=False)

    def loss(logits, value, mask, batch):
        return ppo_loss(masked_categorical(logits, mask), value, weigh(batch), config)[0]

    policy, critic = jax.grad(loss, (0, 1))(logits, value, mask, batch)
    np.testing.assert_array_equal(policy[3:], 0.0)
    np.testing.assert_allclose(critic[:5], -0.5 / 5, rtol=1e-5)
    assert critic[5] == 0.0
    chosen = jax.tree.map(lambda x: x[:3], batch)
    alone, _ = jax.grad(loss, (0, 1))(logits[:3], value[:3], mask[:3], chosen)
    np.testing.assert_allclose(policy[:3], alone, rtol=1e-5, atol=1e-7)
    # Neither weight anywhere: nothing is learned.
    forced = jax.tree.map(lambda x: x[5:], batch)
    for gradient in jax.grad(loss, (0, 1))(logits[5:], value[5:], mask[5:], forced):
        np.testing.assert_array_equal(gradient, 0.0)


def test_a_sample_of_zeros_adds_nothing():
    """Padding of a block: nothing to the gradient, nor to any scalar; two of three samples are real."""
    rng = np.random.default_rng(4)
    two = Batch(
        action=jnp.array([2, 1]),
        **{
            name: jnp.asarray(rng.random(2), jnp.float32)
            for name in ("log_prob", "value", "advantage", "target", "weight", "value_weight")
        },
    )

    def loss(params, allowed, samples):
        mask = jnp.broadcast_to(allowed[:, None], (*allowed.shape, 3))
        logits = params[:3] + params[3] * mask
        value = params[4] + samples.value
        return ppo_loss(
            masked_categorical(logits, mask), value, samples, PPOConfig(clip_epsilon=0.2)
        )

    params = jnp.asarray(rng.normal(size=5), jnp.float32)
    allowed_and_two = jnp.ones(2, bool), two
    alone = jax.grad(loss, has_aux=True)(params, *allowed_and_two)
    padded = jax.tree.map(lambda x: jnp.concatenate([x, jnp.zeros_like(x[:1])]), allowed_and_two)
    among = jax.grad(loss, has_aux=True)(params, *padded)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(1.5 * b, a, rtol=1e-5, atol=1e-7), alone, among
    )


def test_the_loss_of_a_minibatch_is_the_mean_of_its_parts():
    """Its gradient and every scalar, however the decisions with a choice are spread over the devices."""
    rng = np.random.default_rng(3)
    shape = 4, 6
    batch = Batch(
        action=jnp.asarray(rng.integers(0, 3, shape)),
        log_prob=jnp.asarray(rng.normal(-1.0, 0.3, shape), jnp.float32),
        value=jnp.asarray(rng.normal(size=shape), jnp.float32),
        advantage=jnp.asarray(rng.normal(2.0, 3.0, shape), jnp.float32),
        target=jnp.asarray(rng.normal(size=shape), jnp.float32),
        weight=jnp.asarray(rng.random(shape) < np.array([[0.9], [0.5], [0.1], [0.0]]), jnp.float32),
        value_weight=jnp.asarray(rng.random(shape) < 0.5, jnp.float32),
    )
    weighed = weigh(batch)
    config = PPOConfig(clip_epsilon=0.2, entropy_coef=0.1)
    table = jnp.asarray(rng.normal(size=(3,)), jnp.float32)

    def loss(params, samples):
        logits = jnp.broadcast_to(params, (*samples.value.shape, 3))
        value = samples.value + params[0]
        mask = jnp.ones_like(logits, bool)
        return ppo_loss(masked_categorical(logits, mask), value, samples, config)

    whole = jax.grad(loss, has_aux=True)(table, weighed)
    halves = [
        jax.grad(loss, has_aux=True)(table, jax.tree.map(lambda x, part=part: x[part], weighed))
        for part in (slice(0, 2), slice(2, 4))
    ]
    mean = jax.tree.map(lambda a, b: 0.5 * (a + b), *halves)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-6), whole, mean)
    # by hand, over the decisions with a choice alone
    some = np.asarray(batch.weight) > 0
    advantage = np.asarray(batch.advantage)
    standard = (advantage - advantage[some].mean()) / advantage[some].std()
    log_prob = np.log(np.exp(table) / np.exp(table).sum())[np.asarray(batch.action)]
    ratio = np.exp(log_prob - np.asarray(batch.log_prob))
    surrogate = np.minimum(ratio * standard, np.clip(ratio, 0.8, 1.2) * standard)
    assert whole[1]["policy_loss"] == pytest.approx(-surrogate[some].mean(), rel=1e-4)
    assert whole[1]["choice_share"] == pytest.approx(some.mean())
    # A policy that is less sure has a lower loss: the bonus is subtracted.
    probs = np.exp(table) / np.exp(table).sum()
    assert whole[1]["entropy"] == pytest.approx(-(probs * np.log(probs)).sum(), rel=1e-4)
    parts = whole[1]["policy_loss"] + config.value_coef * whole[1]["value_loss"]
    expected = parts - config.entropy_coef * whole[1]["entropy"]
    assert whole[1]["loss"] == pytest.approx(float(expected), rel=1e-5)


def test_explained_variance():
    target, ones = jnp.arange(10.0), jnp.ones(10)
    assert explained_variance(target, target, ones) == 1.0
    assert explained_variance(jnp.full(10, 4.5), target, ones) == pytest.approx(0.0, abs=1e-6)
    assert np.isinf(explained_variance(target, ones, ones))
    assert np.isinf(explained_variance(target, target, jnp.zeros(10)))
    # Where nothing has a weight, anything may be.
    value = jnp.where(target < 5, 2.0, 1e6)
    weight = jnp.where(target < 5, 1.0, 0.0)
    assert explained_variance(value, target, weight) == pytest.approx(0.0, abs=1e-6)
