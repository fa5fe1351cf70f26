"""The PPO objective."""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from train.algorithms.networks import Categorical
from train.algorithms.ppo.settings import PPOConfig


@struct.dataclass
class Batch:
    """Samples to learn from, without observations and masks; every array is `(...)`."""

    action: jax.Array  # int32
    log_prob: jax.Array  # of the action, under the policy that acted
    value: jax.Array  # estimate at the time of acting
    advantage: jax.Array
    target: jax.Array  # for the value
    weight: jax.Array  # in the policy's terms: 0 where there was no choice
    value_weight: jax.Array  # in the value's term: 0 where no advantage needs the value


def clipped_surrogate(
    log_prob: jax.Array, old_log_prob: jax.Array, advantage: jax.Array, clip_epsilon: float
) -> jax.Array:
    """The objective to maximise, eq. (9) of the paper, for each sample.

    Its gradient is zero where the ratio has left [1 - eps, 1 + eps] in the direction that the advantage rewards.

    Args:
        log_prob: `(...)`, log-probability of the action under the policy being learned.
        old_log_prob: `(...)`, the same under the policy that acted.
        advantage: `(...)`.
        clip_epsilon: eps.
    """
    ratio = jnp.exp(log_prob - old_log_prob)
    clipped = jnp.clip(ratio, 1.0 - clip_epsilon, 1.0 + clip_epsilon)
    return jnp.minimum(ratio * advantage, clipped * advantage)


def value_loss(
    value: jax.Array, old_value: jax.Array, target: jax.Array, clip_epsilon: float | None
) -> jax.Array:
    """Half the squared error of each sample, `(...)`.

    With `clip_epsilon` it is the larger of that and the error of the value clipped to within eps of the old one
    (Schulman et al.'s implementation).
    """
    error = jnp.square(value - target)
    if clip_epsilon is not None:
        kept = old_value + jnp.clip(value - old_value, -clip_epsilon, clip_epsilon)
        error = jnp.maximum(error, jnp.square(kept - target))
    return 0.5 * error


def leaves_choice(mask: jax.Array) -> jax.Array:
    """Whether masks `(..., num_actions)` allow more than one action, `(...)` bool."""
    return jnp.sum(mask, axis=-1) > 1


def weigh(batch: Batch) -> Batch:
    """Prepares a whole minibatch, leaves `(...)`, for `ppo_loss`, which takes it whole or in parts.

    Advantages are standardised over the decisions that leave a choice; only these have a weight. With a long cooldown
    nearly all decisions allow a single action, and they would drown the others in the standardisation of advantages,
    in the clipped norm of the gradient, and in the metrics.
    """
    weight, value_weight = (
        each / jnp.maximum(jnp.mean(each), 1e-8) for each in (batch.weight, batch.value_weight)
    )
    advantage = standardize(batch.advantage, weight)
    return dataclasses.replace(batch, advantage=advantage, weight=weight, value_weight=value_weight)


def standardize(advantage: jax.Array, weight: jax.Array, eps: float = 1e-8) -> jax.Array:
    """Shifts and scales to mean 0 and standard deviation 1, under weights of mean 1 or all 0; all `(...)`."""
    centred = advantage - jnp.mean(advantage * weight)
    return centred / (jnp.sqrt(jnp.mean(jnp.square(centred) * weight)) + eps)


def ppo_loss(
    distribution: Categorical, value: jax.Array, batch: Batch, config: PPOConfig
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Loss to minimise, of samples of a minibatch; the loss of the whole is the mean over its parts.

    A sample whose weights are both 0 adds nothing.

    Args:
        distribution: `(...)`, policy being learned, over the allowed actions.
        value: `(...)`, value being learned.
        batch: samples from the result of `weigh`.
        config: gives the clip and the weights of the terms.

    Returns:
        The loss `()`, and scalars that describe it.
    """
    weight = batch.weight
    log_prob = distribution.log_prob(batch.action)
    surrogate = clipped_surrogate(log_prob, batch.log_prob, batch.advantage, config.clip_epsilon)
    policy_term = -jnp.mean(surrogate * weight)
    value_clip = config.clip_epsilon if config.clip_value else None
    value_error = value_loss(value, batch.value, batch.target, value_clip)
    value_term = jnp.mean(value_error * batch.value_weight)
    entropy = jnp.mean(distribution.entropy() * weight)
    loss = policy_term + config.value_coef * value_term - config.entropy_coef * entropy
    log_ratio = log_prob - batch.log_prob
    ratio = jnp.exp(log_ratio)
    outside = jnp.abs(ratio - 1.0) > config.clip_epsilon
    metrics = {
        "loss": loss,
        "policy_loss": policy_term,
        "value_loss": value_term,
        "entropy": entropy,
        # the non-negative, low-variance estimator of http://joschu.net/blog/kl-approx.html
        "approx_kl": jnp.mean((ratio - 1.0 - log_ratio) * weight),
        "clip_fraction": jnp.mean(outside * weight),
        "choice_share": jnp.mean(weight > 0.0),
    }
    return loss, metrics


def explained_variance(value: jax.Array, target: jax.Array, weight: jax.Array) -> jax.Array:
    """Share of the targets' variance that the values explain; 1 is perfect, 0 no better than a constant.

    All arguments are `(...)`. The result is infinite if the targets do not vary or none has a weight.
    """

    def variance(of: jax.Array) -> jax.Array:
        mean = jnp.sum(of * weight) / divisor
        return jnp.sum(jnp.square(of - mean) * weight) / divisor

    # Zero divisors are replaced before the division, because unused results must be finite, too.
    total = jnp.sum(weight)
    divisor = jnp.where(total > 0.0, total, 1.0)
    spread = variance(target)
    varies = spread > 0.0
    missed = variance(target - value) / jnp.where(varies, spread, 1.0)
    return jnp.where(varies, 1.0 - missed, jnp.inf)
