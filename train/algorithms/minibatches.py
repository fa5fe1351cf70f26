"""Minibatches of whole environments, and gradient steps on them."""

import math
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
Loss = Callable[[Any, Any, Any], tuple[jax.Array, dict[str, jax.Array]]]

# Rows of a minibatch that a CPU processes at once: few enough that the last block wastes little, enough for matrix
# products to run at full speed. Other devices process all rows at once.
ROWS_AT_ONCE = 512


def split_environments(key: jax.Array, samples: Any, num_minibatches: int) -> Any:
    """Deals out the environments: each minibatch gets one of every `num_minibatches` neighbours at random.

    Dealing whole environments keeps the layout of the rollout; shuffling single steps costs more than their
    decorrelation is worth. Dealing among neighbours saves devices that share them from exchanging samples.

    Args:
        key: key of the random deal.
        samples: leaves `(num_envs, ...)`.
        num_minibatches: number of minibatches, a divisor of num_envs.

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


def mean_in_blocks(function: Callable[[jax.Array], Result], teaches: jax.Array) -> Result:
    """The mean of `function` over all rows, computed in blocks; rows that do not teach are not read and add nothing.

    Args:
        function: maps row numbers `(some,)` to means over these rows, in any tree; a number out of range adds nothing.
        teaches: `(num_rows,)` bool.
    """
    count = teaches.size
    block = min(ROWS_AT_ONCE, count) if jax.default_backend() == "cpu" else count

    def share(rows: jax.Array) -> Result:
        """Contribution of rows `(block,)` to the means."""
        return jax.tree.map(lambda mean: mean * (block / count), function(rows))

    shapes = jax.eval_shape(share, jax.ShapeDtypeStruct((block,), jnp.int32))
    nothing = jax.tree.map(jnp.zeros_like, shapes)
    add = lambda _, rows, sums: jax.tree.map(jnp.add, sums, share(rows))  # noqa: E731
    return for_true_rows(teaches, block, add, nothing)


def minibatch_gradient(
    loss: Loss, params: Any, seen: Any, minibatch: tuple[jax.Array, jax.Array, Any]
) -> tuple[Any, dict[str, jax.Array]]:
    """Gradient of a minibatch's mean loss, and the scalars that describe the loss; arguments as in `run_epochs`."""
    environments, teaches, samples = minibatch
    shape = jax.tree.leaves(seen)[0].shape[: teaches.ndim]
    number = jnp.swapaxes(jnp.arange(math.prod(shape)).reshape(shape), 0, 1)
    # Every device holds a contiguous run of environments of the same length, and numbers its own from 0.
    place = number[environments % shape[1]].ravel()
    seen, samples = jax.tree.map(
        lambda leaf: leaf.reshape(-1, *leaf.shape[teaches.ndim :]), (seen, samples)
    )

    def pick(tree: Any, rows: jax.Array) -> Any:
        """These rows of every leaf; a row number out of range gives zeros."""
        take = partial(jnp.take, indices=rows, axis=0, mode="fill", fill_value=0)
        return jax.tree.map(take, tree)

    def of_rows(rows: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
        """Gradient and scalars of these rows; a number out of range stays out of range in `seen`."""
        places = jnp.take(place, rows, mode="fill", fill_value=number.size)
        return jax.grad(loss, has_aux=True)(params, pick(seen, places), pick(samples, rows))

    return mean_in_blocks(of_rows, teaches.ravel())


def run_epochs(
    loss: Loss,
    optimizer: optax.GradientTransformation,
    start: tuple[Any, Any],
    seen: Any,
    minibatches: tuple[jax.Array, jax.Array, Any],
    num_epochs: int,
    mesh: Mesh,
) -> tuple[Any, Any, dict[str, jax.Array]]:
    """Epochs of gradient steps on the samples that teach; the devices share each minibatch.

    A step exchanges a single message between devices: the gradient and the scalars as one vector. Between processes
    the number of messages determines the cost, because each message waits until every process is awake.

    Args:
        loss: `(params, seen, samples)` to the loss to minimise, and scalars that describe it. All are means over
            samples, to which a sample of zeros adds nothing.
        optimizer: optimiser of optax.
        start: parameters, and the optimiser's state.
        seen: the large part of the samples, leaves `(num_steps, num_envs, ...)` in the layout of the rollout.
        minibatches: numbers of the environments, `(num_minibatches, environments)`; which of their samples teach, bool
            `(num_minibatches, environments, num_steps, ...)`, where the others count as zeros; and the rest of these
            samples, leaves with the same leading axes.
        num_epochs: passes over all minibatches.
        mesh: of `environment_mesh`; its number of devices divides the environments of a minibatch.

    Returns:
        Parameters, the optimiser's state, and the scalars averaged over the steps, including `grad_norm`.
    """

    def step(
        seen: Any, carry: tuple[Any, Any], batch: tuple[jax.Array, jax.Array, Any]
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """One gradient step: a device reads its own samples of the minibatch, and the update is the same on all."""
        params, opt_state = carry
        own, restore = ravel_pytree(minibatch_gradient(loss, params, seen, batch))
        gradient, metrics = restore(lax.pmean(own, mesh.axis_names))
        squares = (jnp.sum(jnp.square(leaf)) for leaf in jax.tree.leaves(gradient))
        metrics["grad_norm"] = jnp.sqrt(sum(squares))
        change, opt_state = optimizer.update(gradient, opt_state, params)
        return (optax.apply_updates(params, change), opt_state), metrics

    def epochs(
        start: tuple[Any, Any], seen: Any, minibatches: tuple[jax.Array, jax.Array, Any]
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """All epochs on a device's own environments; the scalars are `(num_epochs, num_minibatches)`."""

        def epoch(carry: tuple[Any, Any], _: None) -> Any:
            return lax.scan(partial(step, seen), carry, minibatches)

        return lax.scan(epoch, start, None, length=num_epochs)

    same, shared = PartitionSpec(), PartitionSpec(None, mesh.axis_names)
    (params, opt_state), metrics = jax.shard_map(
        epochs, mesh=mesh, in_specs=(same, shared, shared), out_specs=same, check_vma=False
    )(start, seen, minibatches)
    return params, opt_state, jax.tree.map(jnp.mean, metrics)
