"""Neighbours by bit sets, elsewhere than on a CPU: every lane marks which places in road order it holds.

A GPU is bound by the bytes that one launch leaves in memory for another. The bit sets of an environment take a few
hundred bytes, and XLA for GPUs computes the tables below inside the reads of them, so it never writes them. XLA for
CPUs would write them, which costs more than the running counts of `medjax.traffic.neighbours`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.numerics.gathers import read, write

NOBODY = -1
WORD = 32  # places that a word of a bit set marks


def find_by_bits(
    order: jax.Array, own: jax.Array, other: jax.Array, target: jax.Array, num_lanes: int
) -> tuple[jax.Array, ...]:
    """Slots of the leader, the follower and those in the target lane, `(N,)` int32 each, NOBODY for none.

    The follower in the target lane is the vehicle itself if it covers that lane.

    Args:
      order: (N,) int32, slots from the rearmost to the foremost; N < 32768.
      own, other, target: (N,) int32, lanes by slot; num_lanes for none.
      num_lanes: of the road; at most 127.
    """
    slots = order.shape[-1]
    # Behind the barriers 16 bits reach memory: XLA would fuse the conversion into each reader, and write 32.
    rank = write(jnp.zeros((slots,), jnp.int16), order, jnp.arange(slots, dtype=jnp.int16))
    rank = jax.lax.optimization_barrier(rank).astype(jnp.int32)
    lanes = read((own | other << 8).astype(jnp.int16), order).astype(jnp.int32)
    words = _mark(lanes & 0xFF, lanes >> 8, num_lanes)
    ahead, behind = _nearest(words)
    row = words.shape[1] * WORD
    slot_at = jnp.pad(order, (0, row - slots), constant_values=NOBODY).astype(jnp.int16)

    def at(table: jax.Array, lane: jax.Array, place: jax.Array) -> jax.Array:
        return read(slot_at, read(table, lane * row + place))

    found = (
        at(ahead, own, rank),
        at(behind, own, rank),
        at(ahead, target, rank),
        at(behind, target, rank + 1),
    )
    return tuple(slot.astype(jnp.int32) for slot in jax.lax.optimization_barrier(found))


def _mark(own: jax.Array, other: jax.Array, num_lanes: int) -> jax.Array:
    """Bit sets `(num_lanes + 1, words)` uint32 of lanes `(N,)` in road order; the last place and lane are empty."""
    slots, lane = own.shape[0], jnp.arange(num_lanes + 1, dtype=jnp.int32)[:, None]
    words = slots // WORD + 1
    is_there = ((own == lane) | (other == lane)) & (lane < num_lanes)
    is_there = jnp.pad(is_there, ((0, 0), (0, words * WORD - slots))).reshape(-1, words, WORD)
    bits = jnp.where(is_there, jnp.uint32(1) << jnp.arange(WORD, dtype=jnp.uint32), jnp.uint32(0))
    return jnp.sum(bits, axis=-1, dtype=jnp.uint32)


def _nearest(words: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The next marked place after each place, and the last one before it, `(lanes * words * 32,)` int32.

    The last place, which nobody holds, stands for none.
    """
    block = jnp.arange(words.shape[1], dtype=jnp.int32)
    start, none = block * WORD, words.shape[1] * WORD - 1
    marked = (words != 0)[:, None, :]
    later = marked & (block > block[:, None])
    earlier = marked & (block < block[:, None])
    after = jnp.min(jnp.where(later, (start + _lowest(words))[:, None], none), axis=-1)
    before = jnp.max(jnp.where(earlier, (start + _highest(words))[:, None], -1), axis=-1)
    before = jnp.where(before < 0, none, before)

    bit, word = jnp.arange(WORD, dtype=jnp.uint32), words[:, :, None]
    above = word & (jnp.uint32(2**WORD - 2) << bit)
    below = word & ((jnp.uint32(1) << bit) - 1)
    ahead = jnp.where(above != 0, start[:, None] + _lowest(above), after[:, :, None])
    behind = jnp.where(below != 0, start[:, None] + _highest(below), before[:, :, None])
    return ahead.reshape(-1), behind.reshape(-1)


def _highest(word: jax.Array) -> jax.Array:
    """Index of the highest marked bit, int32; -1 for none."""
    return WORD - 1 - jax.lax.clz(word).astype(jnp.int32)


def _lowest(word: jax.Array) -> jax.Array:
    """Index of the lowest marked bit, int32; -1 for none."""
    return _highest(word & (~word + 1))
