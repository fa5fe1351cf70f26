"""Lane changes: everyone decides at once, looking one way per tick.

All vehicles that change in one tick change to the same side. Two of them that enter one lane come
from one lane, where they already keep their distance, so no gap is ever taken from both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.config import LaneChangeParams
from medjax.traffic.car_following import (
    Drivers,
    Platooning,
    following_acceleration,
    gap_between,
)
from medjax.traffic.mobil import is_safe, mobil_incentive
from medjax.traffic.neighbours import NOBODY, Neighbours


class Wish(NamedTuple):
    """What each vehicle must do across the road, `(N,)` each."""

    direction: jax.Array  # int32: -1 must go left, +1 right, 0 need not change
    urgency: jax.Array  # 0 to 1, adds bias to a mandatory change
    stay: jax.Array  # bool: no change but a mandatory one


def looking(tick: jax.Array, groups: int) -> tuple[jax.Array, jax.Array]:
    """The side looked at in a tick and whose turn it is.

    Even ticks look left, odd ticks right. Slot s belongs to group s % groups; groups take turns, so
    that each vehicle looks both ways once in 2 * groups ticks, and a tick judges one group only.

    Returns:
      (direction () int32, -1 or +1; group () int32)
    """
    return jnp.where(tick % 2 == 0, -1, 1), tick // 2 % groups


def pick_group(values: jax.Array, group: jax.Array, groups: int) -> jax.Array:
    """Entries of slots group, group + groups, ...: (N,) to (ceil(N / groups),), padded with zeros."""
    rows = jnp.pad(values, (0, -values.shape[0] % groups)).reshape(-1, groups)
    return jax.lax.dynamic_index_in_dim(rows, group, axis=1, keepdims=False)


def place_group(flags: jax.Array, group: jax.Array, groups: int, num_vehicles: int) -> jax.Array:
    """Flags of one group back to all slots, `(num_vehicles,)` bool, False for the other groups."""
    return (flags[:, None] & (jnp.arange(groups) == group)).ravel()[:num_vehicles]


def decide(
    drivers: Drivers,
    neighbours: Neighbours,
    following: jax.Array,
    acceleration: jax.Array,
    direction: jax.Array,
    group: jax.Array,
    groups: int,
    may_change: jax.Array,
    wish: Wish,
    platooning: Platooning,
    params: LaneChangeParams,
) -> jax.Array:
    """Which vehicles change lanes now, `(N,)` bool.

    Args:
      drivers: (N,) each.
      neighbours: in the own lane, and in the lane on the side of `direction`, (N,) each.
      following: (N,) m/s^2, each vehicle's car-following acceleration in its lane.
      acceleration: (N,) m/s^2, the same, with the end of an acceleration lane counted.
      direction: () -1 or +1, the side looked at.
      group, groups: whose turn it is (`looking`); others keep their lane.
      may_change: (N,) bool, on the road, and the target lane exists.
      wish: (N,) each, mandatory changes; they add a bias, safety is never waived.
    """

    def pick(values: jax.Array) -> jax.Array:
        return pick_group(values, group, groups)

    own, neighbours, wish = jax.tree.map(pick, (drivers, neighbours, wish))
    leader, follower = drivers.at(neighbours.target_leader), drivers.at(neighbours.target_follower)
    has_leader = neighbours.target_leader != NOBODY
    has_follower = neighbours.target_follower != NOBODY
    old_follower = drivers.at(neighbours.follower)
    old_leader = drivers.at(neighbours.leader)
    has_old_follower = neighbours.follower != NOBODY

    own_after = following_acceleration(own, leader, has_leader, platooning)
    new_after = following_acceleration(follower, own, has_follower, platooning)
    new_before = following[jnp.maximum(neighbours.target_follower, 0)]
    old_after = following_acceleration(
        old_follower, old_leader, neighbours.leader != NOBODY, platooning
    )
    old_before = following[jnp.maximum(neighbours.follower, 0)]

    incentive = mobil_incentive(
        pick(acceleration),
        own_after,
        jnp.where(has_old_follower, old_before, 0.0),
        jnp.where(has_old_follower, old_after, 0.0),
        jnp.where(has_follower, new_before, 0.0),
        jnp.where(has_follower, new_after, 0.0),
        politeness=params.politeness,
    )
    safe = is_safe(
        own_after,
        jnp.where(has_follower, new_after, 0.0),
        jnp.where(has_leader, gap_between(own, leader), jnp.inf),
        jnp.where(has_follower, gap_between(follower, own), jnp.inf),
        safe_braking=params.safe_braking,
        min_gap_ahead=own.min_gap,
        min_gap_behind=follower.min_gap,
    )
    mandatory = wish.direction == direction
    bias = jnp.where(
        mandatory,
        params.mandatory_bias + wish.urgency * params.urgency_bias,
        params.right_bias * direction,
    )
    wants = incentive + bias > params.threshold
    free = (wish.direction == 0) & ~wish.stay
    changes = safe & wants & (mandatory | free)
    return may_change & place_group(changes, group, groups, may_change.shape[0])
