"""Who is ahead and who is behind, in one's own lane and in the lane one looks at."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

NOBODY = -1


class Neighbours(NamedTuple):
    """Slots of the nearest vehicles, each `(N,)` int32, NOBODY where there is none."""

    leader: jax.Array  # ahead in the own lane
    follower: jax.Array  # behind in the own lane
    target_leader: jax.Array  # ahead in the target lane
    target_follower: jax.Array  # behind in the target lane


def sort_by_road(
    x: jax.Array, active: jax.Array, length_m: jax.Array | float, previous_order: jax.Array
) -> jax.Array:
    """Slots from the rearmost to the foremost vehicle.

    One sort of packed 32-bit keys (position in the high bits, slot in the low bits) costs a tenth of
    an argsort of floats on a CPU. Keys are laid out in the last tick's order first: they are then
    nearly sorted, which the sort rewards with a third of its time.

    Args:
      x: (N,) m, 0 to length_m plus one tick's travel.
      active: (N,) bool; inactive slots sort last.
      length_m: m, sets the resolution: length_m / 2^(31 - slot bits), 0.48 mm for 4 km and 256 slots.
      previous_order: (N,) int32, any permutation of the slots.

    Returns:
      (N,) int32. Vehicles closer than the resolution are ordered by slot.
    """
    slots = x.shape[-1]
    slot_bits = max(1, (slots - 1).bit_length())
    steps = 2 ** (31 - slot_bits)
    # Twice the road's length fits, so that no vehicle just past the end can wrap.
    quantised = jnp.clip(x * (steps / length_m), 0, 2 * steps - 2).astype(jnp.uint32)
    quantised = jnp.where(active, quantised, 2 * steps - 1)
    keys = (quantised << slot_bits) | jnp.arange(slots, dtype=jnp.uint32)
    keys = keys.at[previous_order].get(unique_indices=True, mode="promise_in_bounds")
    mask = jnp.uint32(2**slot_bits - 1)
    return (jnp.sort(keys) & mask).astype(jnp.int32)


def find_neighbours(
    order: jax.Array, lane: jax.Array, target_lane: jax.Array, active: jax.Array, num_lanes: int
) -> Neighbours:
    """Exact nearest vehicles ahead and behind, by one sweep along the road in each direction.

    The sweep carries the last vehicle seen in each lane; a vehicle reads its own and its target
    lane's entry, then writes itself. Lanes are separate carries, picked by comparison: under vmap
    each comparison runs over all environments at once, where an indexed read would visit them one by
    one. Slot and lanes travel in one word, and so do the two answers, since every array that goes
    through a scan costs a transposition.

    Args:
      order: (N,) int32, slots from the rearmost to the foremost (`sort_by_road`); N <= 32767.
      lane: (N,) int32 in [0, num_lanes).
      target_lane: (N,) int32; any value outside [0, num_lanes) finds nobody.
      active: (N,) bool; inactive vehicles neither find nor are found.
      num_lanes: acceleration lane included, at most 127.

    Returns:
      Neighbours, by slot.
    """
    slots = order.shape[-1]
    nowhere = num_lanes  # a lane that nobody reads or writes
    own = jnp.where(active, lane, nowhere)
    exists = (target_lane >= 0) & (target_lane < num_lanes) & active
    target = jnp.where(exists, target_lane, nowhere)
    # 0 stands for nobody, so slots are counted from 1.
    word = (jnp.arange(slots, dtype=jnp.int32) + 1) | own << 16 | target << 24

    def see(
        seen: tuple[jax.Array, ...], word: jax.Array
    ) -> tuple[tuple[jax.Array, ...], jax.Array]:
        slot, own, target = word & 0xFFFF, word >> 16 & 0xFF, word >> 24
        ahead = aside = jnp.zeros_like(word)
        for index, last in enumerate(seen):
            ahead = jnp.where(own == index, last, ahead)
            aside = jnp.where(target == index, last, aside)
        seen = tuple(jnp.where(own == index, slot, last) for index, last in enumerate(seen))
        return seen, ahead << 16 | aside

    nobody_yet = (jnp.zeros((), jnp.int32),) * num_lanes
    words = word[order]
    behind = jax.lax.scan(see, nobody_yet, words)[1]
    ahead = jax.lax.scan(see, nobody_yet, words, reverse=True)[1]
    # rank[slot]: where it stands in the order; reads the sweeps back by slot.
    rank = (
        jnp.zeros_like(order)
        .at[order]
        .set(jnp.arange(slots, dtype=jnp.int32), unique_indices=True, mode="promise_in_bounds")
    )
    behind, ahead = behind[rank], ahead[rank]
    return Neighbours(
        leader=(ahead >> 16) - 1,
        follower=(behind >> 16) - 1,
        target_leader=(ahead & 0xFFFF) - 1,
        target_follower=(behind & 0xFFFF) - 1,
    )
