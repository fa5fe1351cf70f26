"""Keeps XLA for CPUs from fusing what is computed into what reads it."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

T = TypeVar("T")


def in_branch(function: Callable[..., T], always: jax.Array, *args: Any) -> T:
    """function(*args), in a branch that is always taken: XLA for CPUs does not fuse across the end of a branch.

    Not to be mapped by `jax.vmap`, which would compute both branches.

    Args:
      function: of arrays, or trees of them.
      always: () bool, true; XLA must not know that.
      args: of the function.
    """

    def zeros(*args: Any) -> T:
        shapes = jax.eval_shape(function, *args)
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    return jax.lax.cond(always, function, zeros, *args)


@custom_vmap
def _settled(values: T, always: jax.Array) -> T:
    if jax.default_backend() != "cpu" or not always.size:
        return values
    return in_branch(lambda values: values, always.reshape(-1)[0], values)


@_settled.def_vmap
def _settled_rows(size: int, batched: Any, values: T, always: jax.Array) -> tuple[T, Any]:
    return _settled(values, always), batched[0]


@jax.custom_jvp
def settled(values: T, always: jax.Array) -> T:
    """The values as they are, computed once and on vectors (`in_branch`).

    XLA for CPUs fuses element-wise code into every reader, also across `lax.optimization_barrier`. So several readers
    compute it several times, and a read by index computes it one entry at a time. On other devices this does nothing.

    Args:
      values: a tree of arrays.
      always: bool of any shape, all true; XLA must not know that.
    """
    return _settled(values, always)


@settled.defjvp
def _settled_jvp(primals: tuple[T, jax.Array], tangents: tuple[T, Any]) -> tuple[T, T]:
    return settled(*primals), tangents[0]
