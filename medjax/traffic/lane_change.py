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


def looking(tick: jax.Array, num_vehicles: int, groups: int) -> tuple[jax.Array, jax.Array]:
    """The side looked at in a tick and whose turn it is.

    Even ticks look left, odd ticks right; slots take turns in groups, so that each vehicle looks
    both ways once in 2 * groups ticks.

    Returns:
      (direction () int32, -1 or +1; turn (num_vehicles,) bool)
    """
    direction = jnp.where(tick % 2 == 0, -1, 1)
    turn = jnp.arange(num_vehicles) % groups == (tick // 2) % groups
    return direction, turn


def decide(
    drivers: Drivers,
    neighbours: Neighbours,
    following: jax.Array,
    acceleration: jax.Array,
    direction: jax.Array,
    may_change: jax.Array,
    wish: Wish,
    platooning: Platooning,
    params: LaneChangeParams,
) -> jax.Array:
    """Which vehicles change lanes now, `(N,)` bool.

    Args:
      drivers: (N,) each.
      neighbours: in the own lane, and in the lane on the side of `direction`.
      following: (N,) m/s^2, each vehicle's car-following acceleration in its lane.
      acceleration: (N,) m/s^2, the same, with the end of an acceleration lane counted.
      direction: () -1 or +1, the side looked at.
      may_change: (N,) bool, on the road, its turn, and the target lane exists.
      wish: mandatory changes; they add a bias, safety is never waived.
    """
    leader, follower = drivers.at(neighbours.target_leader), drivers.at(neighbours.target_follower)
    has_leader = neighbours.target_leader != NOBODY
    has_follower = neighbours.target_follower != NOBODY
    old_follower = drivers.at(neighbours.follower)
    old_leader = drivers.at(neighbours.leader)
    has_old_follower = neighbours.follower != NOBODY

    own_after = following_acceleration(drivers, leader, has_leader, platooning)
    new_after = following_acceleration(follower, drivers, has_follower, platooning)
    new_before = following[jnp.maximum(neighbours.target_follower, 0)]
    old_after = following_acceleration(
        old_follower, old_leader, neighbours.leader != NOBODY, platooning
    )
    old_before = following[jnp.maximum(neighbours.follower, 0)]

    incentive = mobil_incentive(
        acceleration,
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
        jnp.where(has_leader, gap_between(drivers, leader), jnp.inf),
        jnp.where(has_follower, gap_between(follower, drivers), jnp.inf),
        safe_braking=params.safe_braking,
        min_gap_ahead=drivers.min_gap,
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
    return may_change & safe & wants & (mandatory | free)
