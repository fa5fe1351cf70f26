"""Minibatches of whole environments, and gradient steps on them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, PartitionSpec


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
    shape = num_envs // num_minibatches, num_minibatches
    places = jnp.broadcast_to(jnp.arange(num_minibatches), shape)
    lots = jax.random.permutation(key, places, axis=1, independent=True)

    def deal(values: jax.Array) -> jax.Array:
        groups = values.reshape(-1, num_minibatches, *values.shape[1:])
        return jax.vmap(lambda group, lot: group[lot], out_axes=1)(groups, lots)

    return jax.tree.map(deal, samples)


def descend(
    loss: Callable[[Any, Any], tuple[jax.Array, dict[str, jax.Array]]],
    optimizer: optax.GradientTransformation,
    start: tuple[Any, Any],
    minibatches: Any,
    num_epochs: int,
    mesh: Mesh,
) -> tuple[Any, Any, dict[str, jax.Array]]:
    """Epochs of gradient steps, each minibatch shared out among devices.

    A step is one message between devices, its gradient and what describes it as one vector: between processes it is
    the number of messages that costs, each waits until the others are awake.

    Args:
        loss: `(params, samples)` to what is to be minimised, and scalars that describe it. All are means over samples,
            since those of a minibatch are the means of its devices'.
        optimizer: of optax.
        start: parameters, and the optimiser's state.
        minibatches: leaves `(num_minibatches, samples, ...)`.
        num_epochs: passes over all.
        mesh: of `environment_mesh`; its number of devices divides the samples.

    Returns:
        Parameters, the optimiser's state, and the scalars averaged over the steps, `grad_norm` among them.
    """

    def step(carry: tuple[Any, Any], batch: Any) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """A gradient step on a device's own samples `(samples / devices, ...)` of a minibatch, the same on all."""
        params, opt_state = carry
        own, restore = ravel_pytree(jax.grad(loss, has_aux=True)(params, batch))
        gradient, metrics = restore(lax.pmean(own, mesh.axis_names))
        squares = (jnp.sum(jnp.square(leaf)) for leaf in jax.tree.leaves(gradient))
        metrics["grad_norm"] = jnp.sqrt(sum(squares))
        change, opt_state = optimizer.update(gradient, opt_state, params)
        return (optax.apply_updates(params, change), opt_state), metrics

    def epochs(
        start: tuple[Any, Any], minibatches: Any
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        return lax.scan(
            lambda carry, _: lax.scan(step, carry, minibatches), start, None, length=num_epochs
        )

    same, shared = PartitionSpec(), PartitionSpec(None, mesh.axis_names)
    (params, opt_state), metrics = jax.shard_map(
        epochs, mesh=mesh, in_specs=(same, shared), out_specs=same, check_vma=False
    )(start, minibatches)
    return params, opt_state, jax.tree.map(jnp.mean, metrics)
