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


def rows_of(samples: Any, axes: int) -> Any:
    """Leaves of samples with their first `axes` axes as one."""
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[axes:]), samples)


def pick(samples: Any, rows: jax.Array) -> Any:
    """These `(some,)` of the samples, leaves `(num_rows, ...)`; zeros in place of numbers out of range."""
    return jax.tree.map(
        lambda leaf: jnp.take(leaf, rows, axis=0, mode="fill", fill_value=0), samples
    )


def mean_in_blocks(function: Callable[[jax.Array], Result], teaches: jax.Array) -> Result:
    """`function(jnp.arange(num_rows))`, worked out of the rows that teach alone.

    Args:
        function: row numbers `(some,)` to means over these rows, in any tree; a number out of range adds nothing.
        teaches: `(num_rows,)` bool, which rows to read; the others add nothing.
    """
    count = teaches.size
    block = min(ROWS_AT_ONCE, count) if jax.default_backend() == "cpu" else count

    def share(rows: jax.Array) -> Result:
        """What these `(block,)` of the rows add to the means."""
        return jax.tree.map(lambda mean: mean * (block / count), function(rows))

    shapes = jax.eval_shape(share, jax.ShapeDtypeStruct((block,), jnp.int32))
    nothing = jax.tree.map(jnp.zeros_like, shapes)
    return for_true_rows(
        teaches,
        block,
        lambda _, rows, sums: jax.tree.map(jnp.add, sums, share(rows)),
        nothing,
    )


def slope(
    loss: Loss, params: Any, seen: Any, minibatch: tuple[jax.Array, jax.Array, Any]
) -> tuple[Any, dict[str, jax.Array]]:
    """The gradient of the mean loss of a minibatch, and what describes that; arguments as `descend` has them."""
    environments, teaches, samples = minibatch
    shape = jax.tree.leaves(seen)[0].shape[: teaches.ndim]
    number = jnp.swapaxes(jnp.arange(math.prod(shape)).reshape(shape), 0, 1)
    # A device has a run of the environments, as many as each other; what it has is numbered from 0.
    place = number[environments % shape[1]].ravel()
    seen, samples = rows_of(seen, teaches.ndim), rows_of(samples, teaches.ndim)

    def of_rows(rows: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
        """What these of the samples give; a number out of range is out of range in what was seen, too."""
        places = jnp.take(place, rows, mode="fill", fill_value=number.size)
        return jax.grad(loss, has_aux=True)(params, pick(seen, places), pick(samples, rows))

    return mean_in_blocks(of_rows, teaches.ravel())


def descend(
    loss: Loss,
    optimizer: optax.GradientTransformation,
    start: tuple[Any, Any],
    seen: Any,
    minibatches: tuple[jax.Array, jax.Array, Any],
    num_epochs: int,
    mesh: Mesh,
) -> tuple[Any, Any, dict[str, jax.Array]]:
    """Epochs of gradient steps, each minibatch shared out among devices.

    The cost follows the number of samples that teach.

    A step is one message between devices, its gradient and what describes it as one vector: between processes it is
    the number of messages that costs, each waits until the others are awake.

    Args:
        loss: `(params, seen, samples)` to what is to be minimised, and scalars that describe it. All are means over
            samples, to which a sample of zeros adds nothing.
        optimizer: of optax.
        start: parameters, and the optimiser's state.
        seen: the large part of the samples, leaves `(num_steps, num_envs, ...)` as they were acted.
        minibatches: environments by their numbers, `(num_minibatches, environments)`; which of their samples teach,
            bool `(num_minibatches, environments, num_steps, ...)`, the others being as if they were zeros; and the
            rest of these samples, leaves that begin like that.
        num_epochs: passes over all.
        mesh: of `environment_mesh`; its number of devices divides the environments of a minibatch.

    Returns:
        Parameters, the optimiser's state, and the scalars averaged over the steps, `grad_norm` among them.
    """

    def step(
        seen: Any, carry: tuple[Any, Any], batch: tuple[jax.Array, jax.Array, Any]
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """A gradient step on a device's own samples of a minibatch, the same on all."""
        params, opt_state = carry
        own, restore = ravel_pytree(slope(loss, params, seen, batch))
        gradient, metrics = restore(lax.pmean(own, mesh.axis_names))
        squares = (jnp.sum(jnp.square(leaf)) for leaf in jax.tree.leaves(gradient))
        metrics["grad_norm"] = jnp.sqrt(sum(squares))
        change, opt_state = optimizer.update(gradient, opt_state, params)
        return (optax.apply_updates(params, change), opt_state), metrics

    def epochs(
        start: tuple[Any, Any], seen: Any, minibatches: tuple[jax.Array, jax.Array, Any]
    ) -> tuple[tuple[Any, Any], dict[str, jax.Array]]:
        """All passes on a device's own environments; what describes the steps is `(num_epochs, num_minibatches)`."""

        def epoch(carry: tuple[Any, Any], _: None) -> Any:
            """A pass over all minibatches."""
            return lax.scan(partial(step, seen), carry, minibatches)

        return lax.scan(epoch, start, None, length=num_epochs)

    same, shared = PartitionSpec(), PartitionSpec(None, mesh.axis_names)
    (params, opt_state), metrics = jax.shard_map(
        epochs, mesh=mesh, in_specs=(same, shared, shared), out_specs=same, check_vma=False
    )(start, seen, minibatches)
    return params, opt_state, jax.tree.map(jnp.mean, metrics)
