"""Running mean and variance, which normalise observations and rewards.

Moments of batches are merged by the parallel rule of Chan, Golub and LeVeque (1979, STAN-CS-79-773, eq. 2.1), written
with weights instead of sums so that float32 suffices for any number of samples.
"""

import math

import jax
import jax.numpy as jnp
from flax import struct

from medjax.errors import InputError

MIN_STD = 1e-2  # limits how far a rare change of a nearly constant feature is blown up
MIN_REWARD_STD = 1e-4  # smallest divisor of rewards


@struct.dataclass
class RunningStats:
    """Moments of all samples so far. Without samples, mean 0 and variance 1 make `normalize` only clip."""

    count: jax.Array  # () float32, samples seen
    mean: jax.Array  # (...) float32
    var: jax.Array  # (...) float32, population variance


def init_stats(shape: tuple[int, ...] = ()) -> RunningStats:
    """Moments before the first sample; `shape` is that of a sample."""
    mean, var = jnp.zeros(shape, jnp.float32), jnp.ones(shape, jnp.float32)
    return RunningStats(jnp.float32(0.0), mean, var)


def update_stats(stats: RunningStats, samples: jax.Array) -> RunningStats:
    """Merges a batch of samples into the moments.

    Args:
        stats: moments of samples of shape `(...)`.
        samples: `(batch axes..., ...)`, at least one batch axis; all samples have the same weight.

    Returns:
        The moments of all samples.

    Raises:
        InputError: there are no samples, so they have no mean.
    """
    if samples.size == 0:
        raise InputError(f"samples have shape {samples.shape}, allowed: at least one")
    axes = tuple(range(samples.ndim - stats.mean.ndim))
    size = math.prod(samples.shape[axis] for axis in axes)
    samples = samples.astype(jnp.float32)
    # A second pass corrects the rounding error of the mean: exact to float32 for any offset of the data.
    rough_mean = jnp.mean(samples, axes)
    centred = samples - rough_mean
    rest = jnp.mean(centred, axes)
    batch_mean = rough_mean + rest
    batch_var = jnp.mean(jnp.square(centred), axes) - jnp.square(rest)
    count = stats.count + size
    weight = size / count
    delta = batch_mean - stats.mean
    between = weight * (1.0 - weight) * jnp.square(delta)
    var = (1.0 - weight) * stats.var + weight * batch_var + between
    return RunningStats(count=count, mean=stats.mean + weight * delta, var=jnp.maximum(var, 0.0))


def normalize(stats: RunningStats, samples: jax.Array, clip: float = 10.0) -> jax.Array:
    """`(samples - mean) / std`, clipped to [-clip, clip].

    Args:
        stats: moments of samples of shape `(...)`.
        samples: `(batch axes..., ...)`.
        clip: largest absolute value of the result.
    """
    std = jnp.maximum(jnp.sqrt(stats.var), MIN_STD)
    return jnp.clip((samples - stats.mean) / std, -clip, clip)


def scale_reward(stats: RunningStats, reward: jax.Array) -> jax.Array:
    """Divides rewards by the standard deviation of the discounted sum, without a shift.

    A shift would reward the agent for staying alive or for dying; division leaves the optimal policy unchanged.

    Args:
        stats: moments of the running discounted sum of an episode's rewards, shape `()`.
        reward: `(...)`.
    """
    return reward / jnp.maximum(jnp.sqrt(stats.var), MIN_REWARD_STD)
