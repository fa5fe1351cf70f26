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

# Below this a vehicle hardly moves sideways when it changes lanes.
CRAWL_M_PER_S = 2.0
# What is no more urgent is nobody's concern but one's own.
COURTEOUS_DESIRE = 0.3
# From here on a change is made at any speed; before, at this share of the speed of the one that is then behind.
HASTY_DESIRE = 0.6
EVEN_SPEED = 0.95


class Wish(NamedTuple):
    """What each vehicle must do across the road, `(N,)` each."""

    desire: (
        jax.Array
    )  # -1 to 1: must go left where negative, right where positive; its size says how urgent it is
    stay: jax.Array  # bool: no change but a mandatory one
    may: jax.Array  # bool: nothing but traffic is in the way of a change to the side looked at


class Turn(NamedTuple):
    """Who looks where in a tick: slots group, group + groups, ... look to one side."""

    direction: jax.Array  # () int32, -1 left or +1 right
    group: jax.Array  # () int32
    groups: int


def whose_turn(tick: jax.Array, groups: int) -> Turn:
    """Even ticks look left, odd ticks right, and groups take turns: each looks left, and right in the next tick.

    So each vehicle looks both ways once in 2 * groups ticks, and a tick judges one group only.
    """
    return Turn(jnp.where(tick % 2 == 0, -1, 1), tick // 2 % groups, groups)


def pick_group(tree: T, turn: Turn) -> T:
    """Entries of those whose turn it is: leaves (N,) to (ceil(N / groups),), padded with zeros."""

    def pick(values: jax.Array) -> jax.Array:
        rows = jnp.pad(values, (0, -values.shape[0] % turn.groups)).reshape(-1, turn.groups)
        return jax.lax.dynamic_index_in_dim(rows, turn.group, axis=1, keepdims=False)

    return jax.tree.map(pick, tree)


def place_group(values: jax.Array, turn: Turn, others: jax.Array) -> jax.Array:
    """Values of those whose turn it is back by slot, `(N,)`, with those of the others, `(N,)`.

    A write into an array rather than a select, because XLA does not fuse through it: a select would be
    merged into each of its readers, and the whole decision computed again for each.
    """
    num_vehicles = others.shape[0]
    rows = jnp.pad(others, (0, -num_vehicles % turn.groups)).reshape(-1, turn.groups)
    rows = jax.lax.dynamic_update_index_in_dim(rows, values, turn.group, axis=1)
    return rows.reshape(-1)[:num_vehicles]


class Situation(NamedTuple):
    """What everyone sees of everyone, and does about it in the own lane, `(N,)` each, by slot."""

    leaders: Leader
    followers: Follower
    usual_headway: jax.Array  # s, which drivers keep in the long run
    neighbours: Neighbours  # in the own lane, and in the lane on the side looked at
    courtesy: jax.Array  # m/s^2 at most, of the last look
    following: jax.Array  # m/s^2, by car following alone
    acceleration: jax.Array  # m/s^2, with the end of an acceleration lane counted


Follow = Callable[[Follower, Leader, jax.Array], jax.Array]
"""`(followers, leaders, has_leader)` of one shape to accelerations, m/s^2."""


# What those decide who change lanes; the others, an acceleration that they keep to out of courtesy.
GOES = -jnp.inf


def _for_the_desire(usual: jax.Array, desire: jax.Array, params: LaneChangeParams) -> jax.Array:
    """Headways that are accepted for a change so urgent, s: LMRS, eq (10)."""
    shortest = jnp.minimum(params.accepted_headway, usual)
    return usual + (shortest - usual) * desire


def _courtesy(
    own: Follower,
    leader: Leader,
    own_after: jax.Array,
    concerned: jax.Array,
    params: LaneChangeParams,
) -> jax.Array:
    """Acceleration at most, m/s^2, towards the vehicle ahead in the other lane, of those whom it `concerned`.

    Who must change falls in behind it, and who is behind one that must come makes room, both within comfort: who
    would have to brake harder passes instead.
    """
    closing = jnp.maximum(own.speed - leader.speed, 0.0)
    room = gap_between(own, leader) - 0.5 * own.min_gap
    # Of two side by side, equally fast, the one behind falls back; who stands has done what it could.
    drives = own.speed > CRAWL_M_PER_S
    even = closing < 1.0
    in_comfort = (room > 0.0) & (jnp.square(closing) <= 2.0 * params.courtesy_braking * room)
    bounded = jnp.maximum(own_after, -params.courtesy_braking)
    return jnp.where(concerned & drives & (even | in_comfort), bounded, jnp.inf)


def decide(
    situation: Situation, wish: Wish, turn: Turn, follow: Follow, params: LaneChangeParams
) -> jax.Array:
    """What those whose turn it is do about the lane that they look at, `(C,)`.

    Args:
      situation: of all vehicles.
      wish: mandatory changes; they add a bias, safety is never waived.
      turn: whose turn it is, and the side looked at.
      follow: car following between any two.

    Returns:
      GOES where one changes lanes now, safely. Else the acceleration, m/s^2, that it keeps to for the one ahead in
      that lane, inf where nothing is at stake. One array, since two would be worked out one after the other.
    """
    leaders, followers, usual, neighbours, courtesy, following, acceleration = situation
    own, own_usual, held = pick_group((followers, usual, courtesy), turn)
    seen = pick_group(leaders, turn)
    desire = wish.desire * turn.direction  # to the side looked at
    neighbours, wish = pick_group(neighbours, turn), pick_group(wish, turn)
    leader, leader_desire = of_slots((leaders, desire), neighbours.target_leader)
    old_leader = of_slots(leaders, neighbours.leader)
    follower, follower_usual, new_before = of_slots(
        (followers, usual, following), neighbours.target_follower
    )
    old_follower, old_before = of_slots((followers, following), neighbours.follower)
    has_leader = neighbours.target_leader != NOBODY
    has_follower = neighbours.target_follower != NOBODY
    has_old_leader = neighbours.leader != NOBODY
    has_old_follower = neighbours.follower != NOBODY

    desire = pick_group(desire, turn)
    wanted = jnp.maximum(desire, 0.0)
    # One that comes over from the lane looked at, into the gap that is open in front of this vehicle.
    open_to = has_leader & ~(has_old_leader & (old_leader.rear < leader.rear))
    asked = jnp.where(open_to, jnp.maximum(-leader_desire, 0.0), 0.0)
    stake = jnp.maximum(wanted, asked)
    own = own._replace(time_headway=_for_the_desire(own_usual, stake, params))
    follower = follower._replace(time_headway=_for_the_desire(follower_usual, wanted, params))

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
        # The more urgent, the harder a change may make others, and oneself, brake: LMRS's gap acceptance.
        safe_braking=params.safe_braking * jnp.where(desire > 0.0, desire, 1.0),
        # Who stops to let one in keeps its standing gap: less must do, or both would wait for each other.
        min_gap_ahead=own.min_gap * (1.0 - 0.5 * wanted),
        min_gap_behind=follower.min_gap * (1.0 - 0.5 * wanted),
    )
    mandatory = desire > 0.0
    bias = jnp.where(
        mandatory,
        params.mandatory_bias + wanted * params.urgency_bias,
        params.right_bias * turn.direction,
    )
    wants = incentive + bias > params.threshold
    free = (desire == 0.0) & ~wish.stay
    # Who stands must be able to drive into the other lane, or it would stand in both.
    moves = (own.speed > CRAWL_M_PER_S) | (own_after > 0.5 * own.max_acceleration)
    # With half of the way left, who can still gain on the one behind does so first.
    early = (desire > COURTEOUS_DESIRE) & (desire < HASTY_DESIRE)
    gains = pick_group(acceleration, turn) > 0.25 * own.max_acceleration
    waits = early & gains & has_follower & (own.speed < EVEN_SPEED * follower.speed)
    courtesy = _courtesy(own, leader, own_after, has_leader & (stake > COURTEOUS_DESIRE), params)
    # Left is looked first, and what it asks for holds beside what the right asks for.
    courtesy = jnp.minimum(courtesy, jnp.where(turn.direction > 0, held, jnp.inf))
    goes = wish.may & safe & wants & moves & ~waits & (mandatory | free)
    return jnp.where(goes, GOES, courtesy)
