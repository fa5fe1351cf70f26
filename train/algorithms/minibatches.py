"""Minibatches of whole environments, and gradient steps on them."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, PartitionSpec

from medjax.numerics.rows import for_true_rows

Result = TypeVar("Result")

# On a CPU so many rows of a minibatch are worked on at once: few enough that the last block wastes little, enough for
# matrix products to run at full speed. Elsewhere all at once.
ROWS_AT_ONCE = 512


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


def mean_in_blocks(function: Callable[[Any], Result], teaches: jax.Array, samples: Any) -> Result:
    """`function(samples)`, worked out of those that teach alone.

    Args:
        function: samples `(some, ...)` to means over them, in any tree; a sample of zeros adds nothing to these.
        teaches: `(...)` bool, which samples to read; the others are as if they were zeros.
        samples: leaves `(..., ...)`.
    """
    axes, count = teaches.ndim, teaches.size
    block = min(ROWS_AT_ONCE, count) if jax.default_backend() == "cpu" else count
    flat = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[axes:]), samples)

    def share(rows: jax.Array) -> Result:
        """What these `(block,)` of the samples, and zeros in place of numbers out of range, add to the means."""
        picked = jax.tree.map(
            lambda leaf: jnp.take(leaf, rows, axis=0, mode="fill", fill_value=0), flat
        )
        return jax.tree.map(lambda mean: mean * (block / count), function(picked))

    shapes = jax.eval_shape(share, jax.ShapeDtypeStruct((block,), jnp.int32))
    nothing = jax.tree.map(jnp.zeros_like, shapes)
    return for_true_rows(
        teaches.ravel(),
        block,
        lambda _, rows, sums: jax.tree.map(jnp.add, sums, share(rows)),
        nothing,
    )


def descend(
    loss: Callable[[Any, Any], tuple[jax.Array, dict[str, jax.Array]]],
    optimizer: optax.GradientTransformation,
    start: tuple[Any, Any],
    minibatches: tuple[jax.Array, Any],
    num_epochs: int,
    mesh: Mesh,
) -> tuple[Any, Any, dict[str, jax.Array]]:
    """Epochs of gradient steps, each minibatch shared out among devices.

    The cost follows the number of samples that teach.

    A step is one message between devices, its gradient and what describes it as one vector: between processes it is
    the number of messages that costs, each waits until the others are awake.

    Args:
        loss: `(params, samples)` to what is to be minimised, and scalars that describe it. All are means over samples,
            to which a sample of zeros adds nothing.
        optimizer: of optax.
        start: parameters, and the optimiser's state.
        minibatches: which samples teach, bool `(num_minibatches, samples...)`, the others being as if they were zeros;
            and the samples, leaves `(num_minibatches, samples..., ...)`.
        num_epochs: passes over all.
        mesh: of `environment_mesh`; its number of devices divides the first axis of the samples.

    Returns:
        Parameters, the optimiser's state, and the scalars averaged over the steps, `grad_norm` among them.
    """

    def step(
        carry: tuple[Any, Any], batch: tuple[jax.Array, Any]
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """A gradient step on a device's own samples of a minibatch, the same on all."""
        params, opt_state = carry
        slope = partial(jax.grad(loss, has_aux=True), params)
        own, restore = ravel_pytree(mean_in_blocks(slope, *batch))
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
