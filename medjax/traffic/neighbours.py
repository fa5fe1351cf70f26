"""Who is ahead and who is behind, in one's own lane and in the lane one looks at."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

NOBODY = -1

Turn = tuple[jax.Array, jax.Array, jax.Array]  # slot, its own lane, its target lane


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

    The sweep carries the last slot seen in each lane; a vehicle reads its own and its target lane's
    entry, then writes itself. Both directions share one loop, since a loop's cost is its trips.

    Args:
      order: (N,) int32, slots from the rearmost to the foremost (`sort_by_road`).
      lane: (N,) int32 in [0, num_lanes).
      target_lane: (N,) int32; any value outside [0, num_lanes) finds nobody.
      active: (N,) bool; inactive vehicles neither find nor are found.
      num_lanes: acceleration lane included.

    Returns:
      Neighbours, by slot.
    """
    slots = order.shape[-1]
    nowhere = num_lanes  # a lane that is written but never read
    empty = num_lanes + 1  # a lane that is read but never written
    own = jnp.where(active, lane, nowhere)
    exists = (target_lane >= 0) & (target_lane < num_lanes) & active
    target = jnp.where(exists, target_lane, empty)
    lanes = jnp.arange(num_lanes + 2, dtype=jnp.int32)

    def see(seen: jax.Array, at: Turn) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        slot, own_lane, side = at
        ahead = seen.at[own_lane].get(mode="promise_in_bounds")
        aside = seen.at[side].get(mode="promise_in_bounds")
        return jnp.where(lanes == own_lane, slot, seen), (ahead, aside)

    def sweep(slots_in_turn: jax.Array) -> tuple[jax.Array, jax.Array]:
        start = jnp.full((num_lanes + 2,), NOBODY, jnp.int32)
        turns = (slots_in_turn, own[slots_in_turn], target[slots_in_turn])
        return jax.lax.scan(see, start, turns)[1]

    both = jnp.stack([order[::-1], order])
    found, found_aside = jax.vmap(sweep)(both)
    # rank[slot]: where it stands in the order; reads the sweeps back by slot.
    rank = (
        jnp.zeros_like(order)
        .at[order]
        .set(jnp.arange(slots, dtype=jnp.int32), unique_indices=True, mode="promise_in_bounds")
    )
    from_front = slots - 1 - rank
    visible = active  # the dump lane collects inactive slots, which must read as nobody
    pick = lambda row, at: jnp.where(visible, row[at], NOBODY)  # noqa: E731
    return Neighbours(
        leader=pick(found[0], from_front),
        follower=pick(found[1], rank),
        target_leader=pick(found_aside[0], from_front),
        target_follower=pick(found_aside[1], rank),
    )
