"""Minibatches of whole environments."""

from typing import Any

import jax
import jax.numpy as jnp


def split_environments(key: jax.Array, samples: Any, num_minibatches: int) -> Any:
    """Deals the environments out: of every `num_minibatches` neighbours, each minibatch gets one by lot.

    Whole environments rather than single steps: dealing environments is cheap, and the rollout keeps its layout
    (sorting all steps costs more than it decorrelates). Among neighbours rather than among all: environments are alike,
    so that nothing is lost by it, and devices that share them need not exchange samples.

    Args:
        key: of the lots.
        samples: leaves `(num_envs, ...)`.
        num_minibatches: a divisor of num_envs.

    Returns:
        Leaves `(num_minibatches, num_envs / num_minibatches, ...)`; each sample is in exactly one minibatch.
    """
    num_envs = jax.tree.leaves(samples)[0].shape[0]
    places = jnp.broadcast_to(
        jnp.arange(num_minibatches), (num_envs // num_minibatches, num_minibatches)
    )
    lots = jax.random.permutation(key, places, axis=1, independent=True)

    def deal(values: jax.Array) -> jax.Array:
        groups = values.reshape(-1, num_minibatches, *values.shape[1:])
        return jax.vmap(lambda group, lot: group[lot], out_axes=1)(groups, lots)

    return jax.tree.map(deal, samples)
