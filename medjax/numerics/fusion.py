"""Keeps XLA for CPUs from fusing values into their readers."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

T = TypeVar("T")


@custom_vmap
def _settled(values: T, always: jax.Array) -> T:
    if jax.default_backend() != "cpu" or not always.size:
        return values

    def zeros(values: T) -> T:
        return jax.tree.map(jnp.zeros_like, values)

    return jax.lax.cond(always.reshape(-1)[0], lambda values: values, zeros, values)


@_settled.def_vmap
def _settled_rows(size: int, batched: Any, values: T, always: jax.Array) -> tuple[T, Any]:
    return _settled(values, always), batched[0]


@jax.custom_jvp
def settled(values: T, always: jax.Array) -> T:
    """The values as they are, computed once and on vectors.

    XLA for CPUs fuses element-wise code into every reader, also across `lax.optimization_barrier`. So several readers
    compute it several times, and a read by index computes it one entry at a time. XLA does not fuse across the end of a
    branch. The branch here is always taken. Elsewhere than on a CPU this does nothing.

    Args:
      values: a tree of arrays.
      always: bool of any shape, all true; XLA must not know that.
    """
    return _settled(values, always)


@settled.defjvp
def _settled_jvp(primals: tuple[T, jax.Array], tangents: tuple[T, Any]) -> tuple[T, T]:
    return settled(*primals), tangents[0]
