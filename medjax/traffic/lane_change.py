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


class Turn(NamedTuple):
    """Who looks where in a tick: slots group, group + groups, ... look to one side."""

    direction: jax.Array  # () int32, -1 left or +1 right
    group: jax.Array  # () int32
    groups: int


def whose_turn(tick: jax.Array, groups: int) -> Turn:
    """Even ticks look left, odd ticks right, and groups take turns.

    So each vehicle looks both ways once in 2 * groups ticks, and a tick judges one group only.
    """
    return Turn(jnp.where(tick % 2 == 0, -1, 1), tick // 2 % groups, groups)


def pick_group(values: jax.Array, turn: Turn) -> jax.Array:
    """Entries of those whose turn it is: (N,) to (ceil(N / groups),), padded with zeros."""
    rows = jnp.pad(values, (0, -values.shape[0] % turn.groups)).reshape(-1, turn.groups)
    return jax.lax.dynamic_index_in_dim(rows, turn.group, axis=1, keepdims=False)


def place_group(flags: jax.Array, turn: Turn, num_vehicles: int) -> jax.Array:
    """Flags of those whose turn it is back by slot, `(num_vehicles,)` bool, False for the others.

    A matrix product rather than a select, because XLA does not fuse through it: a select would be
    merged into each of its readers, and the whole decision computed again for each.
    """
    slots = turn.group + turn.groups * jnp.arange(flags.shape[0])
    is_slot = slots[:, None] == jnp.arange(num_vehicles)
    return flags.astype(jnp.float32) @ is_slot.astype(jnp.float32) > 0.5


def decide(
    everyone: Drivers,
    deciders: Drivers,
    neighbours: Neighbours,
    following: jax.Array,
    acceleration: jax.Array,
    direction: jax.Array,
    wish: Wish,
    platooning: Platooning,
    params: LaneChangeParams,
) -> jax.Array:
    """Which of the deciders want to change lanes now and can safely, `(C,)` bool.

    Args:
      everyone: (N,) each, by slot; following: (N,) m/s^2, their car-following accelerations.
      deciders: (C,) each, those whose turn it is, and so for all that follows.
      neighbours: in the own lane, and in the lane on the side of `direction`.
      acceleration: m/s^2, of the deciders, with the end of an acceleration lane counted.
      direction: () -1 or +1, the side looked at.
      wish: mandatory changes; they add a bias, safety is never waived.
    """
    leader, follower = (
        everyone.at(neighbours.target_leader),
        everyone.at(neighbours.target_follower),
    )
    old_leader, old_follower = everyone.at(neighbours.leader), everyone.at(neighbours.follower)
    has_leader, has_follower = (
        neighbours.target_leader != NOBODY,
        neighbours.target_follower != NOBODY,
    )
    has_old_follower = neighbours.follower != NOBODY

    own_after = following_acceleration(deciders, leader, has_leader, platooning)
    new_after = following_acceleration(follower, deciders, has_follower, platooning)
    old_after = following_acceleration(
        old_follower, old_leader, neighbours.leader != NOBODY, platooning
    )
    new_before = following[jnp.maximum(neighbours.target_follower, 0)]
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
        jnp.where(has_leader, gap_between(deciders, leader), jnp.inf),
        jnp.where(has_follower, gap_between(follower, deciders), jnp.inf),
        safe_braking=params.safe_braking,
        min_gap_ahead=deciders.min_gap,
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
    return safe & wants & (mandatory | free)
