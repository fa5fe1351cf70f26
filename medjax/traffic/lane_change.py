"""Lane changes: everyone decides at once, looking one way per tick.

All vehicles that change in one tick change to the same side. Two of them that enter one lane come
from one lane, where they already keep their distance, so no gap is ever taken from both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.traffic.following import Follower, Leader, gap_between, of_slots
from medjax.traffic.mobil import is_safe, mobil_incentive
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.world.params import LaneChangeParams

T = TypeVar("T")


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


def pick_group(tree: T, turn: Turn) -> T:
    """Entries of those whose turn it is: leaves (N,) to (ceil(N / groups),), padded with zeros."""

    def pick(values: jax.Array) -> jax.Array:
        rows = jnp.pad(values, (0, -values.shape[0] % turn.groups)).reshape(-1, turn.groups)
        return jax.lax.dynamic_index_in_dim(rows, turn.group, axis=1, keepdims=False)

    return jax.tree.map(pick, tree)


def place_group(flags: jax.Array, turn: Turn, num_vehicles: int) -> jax.Array:
    """Flags of those whose turn it is back by slot, `(num_vehicles,)` bool, False for the others.

    A write into an array rather than a select, because XLA does not fuse through it: a select would be
    merged into each of its readers, and the whole decision computed again for each.
    """
    rows = jnp.zeros((flags.shape[0], turn.groups), bool)
    rows = jax.lax.dynamic_update_index_in_dim(rows, flags, turn.group, axis=1)
    return rows.reshape(-1)[:num_vehicles]


class Situation(NamedTuple):
    """What everyone sees of everyone, and does about it in the own lane, `(N,)` each, by slot."""

    leaders: Leader
    followers: Follower
    neighbours: Neighbours  # in the own lane, and in the lane on the side looked at
    following: jax.Array  # m/s^2, by car following alone
    acceleration: jax.Array  # m/s^2, with the end of an acceleration lane counted


Follow = Callable[[Follower, Leader, jax.Array], jax.Array]
"""`(followers, leaders, has_leader)` of one shape to accelerations, m/s^2."""


def decide(
    situation: Situation, wish: Wish, turn: Turn, follow: Follow, params: LaneChangeParams
) -> jax.Array:
    """Which of those whose turn it is want to change lanes now and can safely, `(C,)` bool.

    Args:
      situation: of all vehicles.
      wish: mandatory changes; they add a bias, safety is never waived.
      turn: whose turn it is, and the side looked at.
      follow: car following between any two.
    """
    leaders, followers, neighbours, following, acceleration = situation
    own = pick_group(followers, turn)
    seen = pick_group(leaders, turn)
    neighbours, wish = pick_group(neighbours, turn), pick_group(wish, turn)
    leader = of_slots(leaders, neighbours.target_leader)
    old_leader = of_slots(leaders, neighbours.leader)
    follower, new_before = of_slots((followers, following), neighbours.target_follower)
    old_follower, old_before = of_slots((followers, following), neighbours.follower)
    has_leader = neighbours.target_leader != NOBODY
    has_follower = neighbours.target_follower != NOBODY
    has_old_follower = neighbours.follower != NOBODY

    own_after = follow(own, leader, has_leader)
    new_after = follow(follower, seen, has_follower)
    old_after = follow(old_follower, old_leader, neighbours.leader != NOBODY)

    incentive = mobil_incentive(
        pick_group(acceleration, turn),
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
        jnp.where(has_follower, gap_between(follower, seen), jnp.inf),
        safe_braking=params.safe_braking,
        min_gap_ahead=own.min_gap,
        min_gap_behind=follower.min_gap,
    )
    mandatory = wish.direction == turn.direction
    bias = jnp.where(
        mandatory,
        params.mandatory_bias + wish.urgency * params.urgency_bias,
        params.right_bias * turn.direction,
    )
    wants = incentive + bias > params.threshold
    free = (wish.direction == 0) & ~wish.stay
    return safe & wants & (mandatory | free)
