"""Computation on rows of a batch: block by block, or only on the few rows that need it.

Under `jax.vmap` a `lax.cond` becomes a select that runs both branches for every row. If only a few rows need a costly
computation (a reset, the value of a final observation), it is cheaper to collect these rows and compute on blocks of
them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax

Carry = TypeVar("Carry")
Result = TypeVar("Result")

# Rows of this many bytes together, and what works on them, fit a core's cache; with more, every operation goes to
# memory. More than CACHED_ROWS at once gain nothing, however small they are.
CACHED_BYTES = 3 * 2**20
CACHED_ROWS = 128


def rows_that_fit(rows: Any, group: int = 1, copies: int = 1) -> int:
    """How many rows a core's cache holds: a power of two of groups.

    Args:
        rows: leaves `(num_rows, ...)`, or their shapes.
        group: number of adjacent rows that must stay together.
        copies: over how many `jax.vmap` maps the computation.
    """
    leaves = jax.tree.leaves(rows)
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in leaves) / leaves[0].shape[0]
    groups = min(CACHED_ROWS, int(CACHED_BYTES // max(size, 1.0))) // (group * copies)
    return group * 2 ** (max(1, groups).bit_length() - 1)


def in_blocks(
    function: Callable[[Any], Result],
    rows: Any,
    rows_at_once: int = 0,
    out_axes: Any = 0,
    group: int = 1,
) -> Result:
    """function(rows): on a CPU about `rows_at_once` rows at a time, to fit the cache, elsewhere all at once.

    Args:
        function: works on any number of independent rows.
        rows: leaves `(num_rows, ...)`.
        rows_at_once: approximate number of rows per block; 0: `rows_that_fit`.
        out_axes: the result's axis of rows: a number, or a prefix of the result's tree with numbers.
        group: number of adjacent rows that must stay in one block.
    """
    count = jax.tree.leaves(rows)[0].shape[0]
    blocks = -(-count // (rows_at_once or rows_that_fit(rows, group)))
    if jax.default_backend() != "cpu" or count % (blocks * group):
        return function(rows)
    split = jax.tree.map(lambda leaf: leaf.reshape(blocks, count // blocks, *leaf.shape[1:]), rows)

    def join(axis: int, parts: Any) -> Any:
        """Joins the blocks of leaves `(blocks, ..., rows of a block, ...)` on this axis."""

        def whole(leaf: jax.Array) -> jax.Array:
            shape = *leaf.shape[1 : axis + 1], count, *leaf.shape[axis + 2 :]
            return jnp.moveaxis(leaf, 0, axis).reshape(shape)

        return jax.tree.map(whole, parts)

    return jax.tree.map(join, out_axes, lax.map(function, split))


def for_true_rows(
    mask: jax.Array, block: int, body: Callable[[jax.Array, jax.Array, Carry], Carry], carry: Carry
) -> Carry:
    """Calls `body` on blocks of the row numbers at which `mask` is True; no reverse-mode derivative.

    The cost is proportional to the number of True rows, also when the caller is mapped over random seeds.

    Args:
        mask: `(num_rows,)` bool.
        block: rows per call, at least 1.
        body: `(call_number int32, rows (block,) int32, carry) -> carry`. All calls together get the True rows, each
            once and in ascending order. Unused places hold `num_rows`, which is out of range: gather with
            `mode="clip"` and scatter with `mode="drop"`.
        carry: initial value.

    Returns:
        The carry after the last call.
    """
    num_rows = mask.shape[0]
    padded = -(-num_rows // block) * block
    rank = jnp.cumsum(mask, dtype=jnp.int32) - 1
    numbers = jnp.arange(num_rows, dtype=jnp.int32)
    order = jnp.full((padded,), num_rows, jnp.int32)
    order = order.at[jnp.where(mask, rank, padded)].set(numbers, mode="drop")
    num_true = rank[-1] + 1

    def unfinished(loop: tuple[jax.Array, Carry]) -> jax.Array:
        return loop[0] * block < num_true

    def call(loop: tuple[jax.Array, Carry]) -> tuple[jax.Array, Carry]:
        number, value = loop
        rows = lax.dynamic_slice(order, (number * block,), (block,))
        return number + 1, body(number, rows, value)

    return lax.while_loop(unfinished, call, (jnp.int32(0), carry))[1]
