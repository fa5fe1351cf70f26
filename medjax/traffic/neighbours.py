"""Who is ahead and who is behind, in one's own lane and in the lane one looks at."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.gathers import read, write

NOBODY = -1


class Neighbours(NamedTuple):
    """Slots of the nearest vehicles, each `(N,)` int32, NOBODY where there is none."""

    leader: jax.Array  # ahead in the own lane
    follower: jax.Array  # behind in the own lane
    target_leader: jax.Array  # ahead in the target lane
    target_follower: jax.Array  # behind in the target lane; oneself, if one is in that lane

    def in_target(self) -> jax.Array:
        """Whether each is in its target lane already, `(N,)` bool.

        Read off what was found: what leads to the search would be worked out again wherever this is used.
        """
        slots = self.target_follower
        return slots == jnp.arange(slots.shape[0], dtype=jnp.int32)

    def without_target(self, blind: jax.Array) -> Neighbours:
        """The same, but that the `blind`, `(N,)` bool, find nobody in their target lanes."""
        ahead, behind = (
            jnp.where(blind, NOBODY, slots) for slots in (self.target_leader, self.target_follower)
        )
        return self._replace(target_leader=ahead, target_follower=behind)


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
    keys = read(keys, previous_order)
    mask = jnp.uint32(2**slot_bits - 1)
    return (jnp.sort(keys) & mask).astype(jnp.int32)


def find_neighbours(
    order: jax.Array,
    lane: jax.Array,
    other_lane: jax.Array,
    target_lane: jax.Array,
    active: jax.Array,
    num_lanes: int,
) -> Neighbours:
    """Exact nearest vehicles ahead and behind, by counting; one that straddles a line is found in both lanes.

    Along the road, the number of vehicles of each lane so far says where in its lane a vehicle stands,
    and between which two of its target lane. So all vehicles are written into one line, lane by lane,
    and everyone reads the places next to its own and next to the gap it looks at. Nothing is searched
    and nothing runs vehicle by vehicle.

    Args:
      order: (N,) int32, slots from the rearmost to the foremost (`sort_by_road`).
      lane: (N,) int32 in [0, num_lanes).
      other_lane: (N,) int32, the second lane that a vehicle covers; outside [0, num_lanes) for none.
      target_lane: (N,) int32; any value outside [0, num_lanes) finds nobody.
      active: (N,) bool; inactive vehicles neither find nor are found.
      num_lanes: acceleration lane included; (num_lanes + 1) (N + 2) <= 65536.

    Returns:
      Neighbours, by slot.
    """
    slots = order.shape[-1]
    nowhere = num_lanes  # a lane of its own, whose vehicles are written as nobody
    own = jnp.where(active, lane, nowhere)

    def in_a_lane(lanes: jax.Array) -> jax.Array:
        return jnp.where((lanes >= 0) & (lanes < num_lanes) & active, lanes, nowhere)

    lanes = read(own | in_a_lane(target_lane) << 8 | in_a_lane(other_lane) << 16, order)
    own, target, other = lanes & 0xFF, lanes >> 8 & 0xFF, lanes >> 16
    own_place, target_place, other_place = _places(own, other, target, num_lanes + 1)

    # 0 stands for nobody, so slots are counted from 1; every lane begins and ends with a 0.
    line = jnp.zeros(((num_lanes + 1) * (slots + 2),), jnp.int16)
    for lane_of, place in ((own, own_place), (other, other_place)):
        line = write(line, place, jnp.where(lane_of == nowhere, 0, order + 1).astype(jnp.int16))

    places = write(
        jnp.zeros((slots,), jnp.uint32), order, (own_place | target_place << 16).astype(jnp.uint32)
    )
    own_place, target_place = (place.astype(jnp.int32) for place in (places & 0xFFFF, places >> 16))

    def at(place: jax.Array) -> jax.Array:
        return read(line, place).astype(jnp.int32) - 1

    return Neighbours(
        leader=at(own_place + 1),
        follower=at(own_place - 1),
        target_leader=at(target_place + 1),
        target_follower=at(target_place),
    )


def _places(
    own: jax.Array, other: jax.Array, target: jax.Array, num_lanes: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Places in a line of lanes with slots + 2 places each, `(N,)` int32 each.

    Args:
      own, other, target: (N,) int32, lanes in road order; a vehicle is in its own and the other one.

    Returns:
      (place of each vehicle in its own lane; place in the target lane of the last vehicle behind it, or its own
      if it is there, or the lane's place 0 if there is none; its place in the other lane). A vehicle stands at
      place 1 or higher of its lanes.
    """
    slots = own.shape[-1]
    # Several lanes' counts travel in one float32, as many as its 24 bits hold exactly.
    bits = slots.bit_length()
    per_word = 24 // bits
    firsts = range(0, num_lanes, per_word)  # each word's first lane

    def one(lane: jax.Array, first: int) -> jax.Array:
        inside = (lane >= first) & (lane < first + per_word)
        return jnp.where(inside, 1 << (lane - first) * bits, 0)

    sums = [_running_sum(one(own, first) | one(other, first)) for first in firsts]

    def count(lane: jax.Array) -> jax.Array:
        counts = sums[0] >> lane * bits
        for first, word in zip(firsts[1:], sums[1:], strict=True):
            counts = jnp.where(lane < first, counts, word >> (lane - first) * bits)
        return counts & 2**bits - 1

    own_place, target_place, other_place = (
        lane * (slots + 2) + count(lane) for lane in (own, target, other)
    )
    return own_place, target_place, other_place


def _running_sum(values: jax.Array, block: int = 8) -> jax.Array:
    """Cumulative sum, `(N,)` int32, exact up to 2^24.

    Two small matrix products, within blocks and of the blocks before; a third of jnp.cumsum's time on
    a CPU. They ask for all of float32, as a GPU would round the factors to 11 bits otherwise.
    """
    blocks = jnp.pad(values, (0, -values.shape[0] % block)).reshape(-1, block).astype(jnp.float32)
    product = functools.partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
    within = product(blocks, jnp.triu(jnp.ones((block, block), jnp.float32)))
    earlier = jnp.triu(jnp.ones((blocks.shape[0],) * 2, jnp.float32), 1)
    sums = within + product(within[:, -1], earlier)[:, None]
    return sums.reshape(-1)[: values.shape[0]].astype(jnp.int32)
