"""Indexed reads and writes that are cheap under `jax.vmap` on a CPU.

Under vmap an indexed read becomes a read from a matrix, for which XLA for CPUs first writes out a (row, column) pair
per entry. That costs as much as the read. The vmap rule here adds the row's offset to the index and reads one vector.
"""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from medjax.numerics.fusion import in_branch

T = TypeVar("T")

# From this many entries on, reads stand in a branch of their own. Otherwise XLA for CPUs computes whatever depends on
# the reads without vectorising, which is four times as slow.
LONG_READ = 4096

_IN_BOUNDS: dict[str, Any] = {"mode": "promise_in_bounds", "wrap_negative_indices": False}


def _flat(index: jax.Array, row_length: int) -> jax.Array:
    """Indices into the concatenated rows; index is `(rows, ...)`."""
    offsets = jnp.arange(index.shape[0], dtype=jnp.int32) * row_length
    return index + offsets.reshape(-1, *(1,) * (index.ndim - 1))


def with_rows(size: int, tree: T, batched: Any) -> T:
    """Broadcasts leaves to a leading axis of length size, except those that `batched` marks as having it."""

    def give(leaf: jax.Array, has_rows: bool) -> jax.Array:
        return leaf if has_rows else jnp.broadcast_to(leaf, (size, *leaf.shape))

    return jax.tree.map(give, tree, batched)


def _pick(values: jax.Array, index: jax.Array) -> jax.Array:
    return jnp.asarray(values).at[index].get(**_IN_BOUNDS)


def _pick_all(tree: T, index: jax.Array) -> T:
    return jax.tree.map(lambda values: _pick(values, index), tree)


@custom_vmap
def _read(tree: T, index: jax.Array) -> T:
    few = index.size < LONG_READ or len(jax.tree.leaves(tree)) == 1
    if few or jax.default_backend() != "cpu":
        return _pick_all(tree, index)
    return in_branch(_pick_all, index.reshape(-1)[0] >= 0, tree, index)


@_read.def_vmap
def _read_rows(size: int, batched: Any, tree: T, index: jax.Array) -> tuple[T, Any]:
    if any(jax.tree.leaves(batched[0])):  # otherwise one table serves all rows
        tree, index = with_rows(size, (tree, index), tuple(batched))
        index = _flat(index, jax.tree.leaves(tree)[0].shape[1])
        tree = jax.tree.map(lambda values: values.reshape(-1), tree)
    return _read(tree, index), jax.tree.map(lambda _: True, tree)


@jax.custom_jvp
def read(tree: T, index: jax.Array) -> T:
    """tree[index], leaf by leaf.

    Args:
      tree: arrays `(N,)`.
      index: any shape, int32 in [0, N); undefined outside.

    Returns:
      The tree, each leaf with the shape of index.
    """
    return _read(tree, index)


@read.defjvp
def _read_jvp(primals: tuple[T, jax.Array], tangents: tuple[T, Any]) -> tuple[T, T]:
    tree, index = primals

    def change(values: jax.Array, tangent: jax.Array) -> Any:
        if jnp.issubdtype(values.dtype, jnp.floating):
            return _pick(tangent, index)
        return np.zeros(index.shape, jax.dtypes.float0)

    return read(tree, index), jax.tree.map(change, tree, tangents[0])


@custom_vmap
def write(target: jax.Array, index: jax.Array, values: jax.Array) -> jax.Array:
    """Returns target with values at index; not differentiable.

    Args:
      target: (N,); index: (K,) int32 in [0, N), distinct; values: (K,), of target's type.
    """
    return jnp.asarray(target).at[index].set(values, unique_indices=True, **_IN_BOUNDS)


@write.def_vmap
def _write_rows(
    size: int, batched: list[bool], target: jax.Array, index: jax.Array, values: jax.Array
) -> tuple[jax.Array, bool]:
    target, index, values = with_rows(size, (target, index, values), tuple(batched))
    flat = _flat(index, target.shape[1]).reshape(-1)
    return write(target.reshape(-1), flat, values.reshape(-1)).reshape(target.shape), True
