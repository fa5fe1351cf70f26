"""Lane changes: everyone decides at once, looking one way per tick.

All vehicles that change in one tick change to the same side. Two of them that enter one lane come
from one lane, where they already keep their distance, so no gap is ever taken from both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.numerics.sums import rounded
from medjax.traffic.following import Follower, Leader, gap_between, of_slots
from medjax.traffic.mobil import is_safe, mobil_incentive
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.traffic.safety import Tyres, keeps_clear
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
    """Who looks where in a tick: one of `groups` parts of the slots, equally long, looks to one side."""

    direction: jax.Array  # () int32, -1 left or +1 right
    group: jax.Array  # () int32, the part
    groups: int


def whose_turn(tick: jax.Array, groups: int) -> Turn:
    """Even ticks look left, odd ticks right, and groups take turns: each looks left, and right in the next tick.

    So each vehicle looks both ways once in 2 * groups ticks, and a tick judges one group only.
    """
    return Turn(jnp.where(tick % 2 == 0, -1, 1), tick // 2 % groups, groups)


def pick_group(tree: T, turn: Turn) -> T:
    """Entries of those whose turn it is: leaves (N,) to (ceil(N / groups),), padded with zeros."""

    def pick(values: jax.Array) -> jax.Array:
        parts = jnp.pad(values, (0, -values.shape[0] % turn.groups)).reshape(turn.groups, -1)
        return jax.lax.dynamic_index_in_dim(parts, turn.group, keepdims=False)

    return jax.tree.map(pick, tree)


def place_group(values: jax.Array, turn: Turn, others: jax.Array) -> jax.Array:
    """Values of those whose turn it is back by slot, `(N,)`, with those of the others, `(N,)`.

    A write into an array rather than a select, because XLA does not fuse through it: a select would be
    merged into each of its readers, and the whole decision computed again for each.
    """
    num_vehicles = others.shape[0]
    parts = jnp.pad(others, (0, -num_vehicles % turn.groups)).reshape(turn.groups, -1)
    parts = jax.lax.dynamic_update_index_in_dim(parts, values, turn.group, axis=0)
    return parts.reshape(-1)[:num_vehicles]


class Situation(NamedTuple):
    """What everyone sees of everyone, and does about it in the own lane, `(N,)` each, by slot."""

    leaders: Leader
    followers: Follower
    usual_headway: jax.Array  # s, which drivers keep in the long run
    neighbours: Neighbours  # in the own lane, and in the lane on the side looked at
    clearing_s: jax.Array  # s, that each takes to be out of its lane, should it change now
    following: jax.Array  # m/s^2, by car following alone
    acceleration: jax.Array  # m/s^2, with the end of an acceleration lane counted


Follow = Callable[[Follower, Leader, jax.Array], jax.Array]
"""`(followers, leaders, has_leader)` of one shape to accelerations, m/s^2."""


# What those decide who change lanes; the others, an acceleration that they keep to out of courtesy.
GOES = -jnp.inf


def _for_the_desire(usual: jax.Array, desire: jax.Array, params: LaneChangeParams) -> jax.Array:
    """Headways that are accepted for a change so urgent, s: LMRS, eq (10)."""
    shortest = jnp.minimum(params.accepted_headway, usual)
    return usual - rounded((usual - shortest) * desire)


def _courtesy(
    own: Follower,
    leader: Leader,
    own_after: jax.Array,
    concerned: jax.Array,
    yields: jax.Array,
    params: LaneChangeParams,
) -> jax.Array:
    """Acceleration at most, m/s^2, towards the vehicle ahead in the other lane, of those whom it `concerned`.

    Who must change falls in behind it, and who is behind one that must come makes room, both within comfort: who
    would have to brake harder passes instead. Who `yields` brakes steadily from the first: car following brakes late,
    when more than comfort is soon needed, and it would pass after all.
    """
    closing = jnp.maximum(own.speed - leader.speed, 0.0)
    room = gap_between(own, leader) - 0.5 * own.min_gap
    # Of two side by side, equally fast, the one behind falls back; who stands has done what it could.
    drives = own.speed > CRAWL_M_PER_S
    even = closing < 1.0
    needed = jnp.square(closing) / (2.0 * jnp.maximum(room, 0.1))
    in_comfort = (room > 0.0) & (room < params.view_m) & (needed <= params.courtesy_braking)
    wanted = jnp.minimum(own_after, jnp.where(yields, -needed, jnp.inf))
    bounded = jnp.maximum(wanted, -params.courtesy_braking)
    return jnp.where(concerned & drives & (even | in_comfort), bounded, jnp.inf)


class Look(NamedTuple):
    """Those whose turn it is and the gap that they look at, `(C,)` each."""

    own: Follower  # as it would follow there
    leader: Leader  # ahead in that lane
    has_leader: jax.Array  # bool
    follower: Follower  # behind in that lane, as it would follow this vehicle
    has_follower: jax.Array  # bool
    gap_behind: jax.Array  # m, inf where nobody is behind
    old_leader: Leader  # ahead in the own lane
    old_gap: jax.Array  # m, to it, inf where nobody is ahead
    clearing_s: jax.Array  # s, until this vehicle is out of that lane
    desire: jax.Array  # to that side, -1 to 1
    stake: (
        jax.Array
    )  # 0 to 1, how urgent it is to this vehicle, or to one that comes over from there
    own_after: jax.Array  # m/s^2, in that lane
    new_after: jax.Array  # m/s^2, of the one behind in that lane, then
    others: tuple[
        jax.Array, ...
    ]  # m/s^2, of the one behind now, before and after, and of the one behind then


def _look(
    situation: Situation, desire: jax.Array, turn: Turn, follow: Follow, params: LaneChangeParams
) -> Look:
    """What those whose turn it is see beside them; desire `(N,)` is that to the side looked at."""
    leaders, followers, usual, neighbours, clearing_s, following, _ = situation
    mine = followers, usual, leaders, neighbours, clearing_s
    own, own_usual, seen, neighbours, clearing_s = pick_group(mine, turn)
    leader, leader_desire = of_slots((leaders, desire), neighbours.target_leader)
    old_leader = of_slots(leaders, neighbours.leader)
    behind = (followers, usual, following)
    follower, new_usual, new_before = of_slots(behind, neighbours.target_follower)
    old_follower, old_before = of_slots((followers, following), neighbours.follower)
    has_leader, has_follower, has_old_leader, has_old_follower = (
        slots != NOBODY
        for slots in (
            neighbours.target_leader,
            neighbours.target_follower,
            neighbours.leader,
            neighbours.follower,
        )
    )
    desire = pick_group(desire, turn)
    wanted = jnp.maximum(desire, 0.0)
    # One that comes over from the lane looked at, into the gap that is open in front of this vehicle.
    open_to = has_leader & ~(has_old_leader & (old_leader.rear < leader.rear))
    # Or that has come to stand there: the first who can stop for it lets it in, whoever still goes by in between.
    open_to |= has_leader & (leader.speed < CRAWL_M_PER_S)
    stake = jnp.maximum(wanted, jnp.where(open_to, -leader_desire, 0.0))
    own = own._replace(time_headway=_for_the_desire(own_usual, stake, params))
    follower = follower._replace(time_headway=_for_the_desire(new_usual, wanted, params))

    new_after = jnp.where(has_follower, follow(follower, seen, has_follower), 0.0)
    old_after = follow(old_follower, old_leader, has_old_leader)
    others = (
        jnp.where(has_old_follower, old_before, 0.0),
        jnp.where(has_old_follower, old_after, 0.0),
        jnp.where(has_follower, new_before, 0.0),
        new_after,
    )
    return Look(
        own=own,
        leader=leader,
        has_leader=has_leader,
        follower=follower,
        has_follower=has_follower,
        gap_behind=jnp.where(has_follower, gap_between(follower, seen), jnp.inf),
        old_leader=old_leader,
        old_gap=jnp.where(has_old_leader, gap_between(own, old_leader), jnp.inf),
        clearing_s=clearing_s,
        desire=desire,
        stake=stake,
        own_after=follow(own, leader, has_leader),
        new_after=new_after,
        others=others,
    )


def straddling_gap(own: Follower) -> jax.Array:
    """What vehicles that leave a lane keep to the one ahead there, m, half of their standing gap."""
    return 0.5 * own.min_gap


def _is_safe(look: Look, params: LaneChangeParams, tyres: Tyres) -> jax.Array:
    """Whether each could go, `(C,)` bool.

    The more urgent, the harder a change may make others, and oneself, brake (LMRS's gap acceptance). And who stops to
    let one in keeps its standing gap: less must do, or both would wait for each other. Whatever is urgent, everyone can
    still stop behind the one that is then ahead. And who changes is in both lanes until it is out of its own: at their
    speeds it is so before it comes up to the one ahead there.
    """
    wanted = jnp.maximum(look.desire, 0.0)
    own, follower = look.own, look.follower
    ahead = jnp.where(look.has_leader, gap_between(own, look.leader), jnp.inf)
    clear = keeps_clear(own.speed, own.max_acceleration, ahead, look.leader.speed, tyres)
    behind = look.gap_behind
    clear &= keeps_clear(follower.speed, follower.max_acceleration, behind, own.speed, tyres)
    old_speed, old_gap = look.old_leader.speed, look.old_gap - straddling_gap(own)
    clear &= keeps_clear(own.speed, own.max_acceleration, old_gap, old_speed, tyres)
    closing = jnp.maximum(jnp.maximum(own.speed, CRAWL_M_PER_S) - old_speed, 0.0)
    clear &= old_gap > closing * look.clearing_s
    return clear & is_safe(
        look.own_after,
        look.new_after,
        ahead,
        behind,
        safe_braking=params.safe_braking * jnp.where(wanted > 0.0, wanted, 1.0),
        min_gap_ahead=own.min_gap * (1.0 - 0.5 * wanted),
        min_gap_behind=follower.min_gap * (1.0 - 0.5 * wanted),
    )


def decide(
    situation: Situation,
    wish: Wish,
    turn: Turn,
    follow: Follow,
    params: LaneChangeParams,
    tyres: Tyres,
) -> jax.Array:
    """What those whose turn it is do about the lane that they look at, `(C,)`.

    Args:
      situation: of all vehicles.
      wish: mandatory changes; they add a bias, safety is never waived.
      turn: whose turn it is, and the side looked at.
      follow: car following between any two.
      params: of lane changes; tyres: what bounds everyone's braking.

    Returns:
      GOES where one changes lanes now, safely. Else the acceleration, m/s^2, that it keeps to for the one ahead in
      that lane, inf where nothing is at stake. One array, since two would be worked out one after the other.
    """
    look = _look(situation, wish.desire * turn.direction, turn, follow, params)
    acceleration, wish = pick_group((situation.acceleration, wish), turn)
    own, desire = look.own, look.desire

    incentive = mobil_incentive(
        acceleration, look.own_after, *look.others, politeness=params.politeness
    )
    urgent = params.mandatory_bias + desire * params.urgency_bias
    bias = jnp.where(desire > 0.0, urgent, params.right_bias * turn.direction)
    wants = (incentive + bias > params.threshold) & jnp.where(
        wish.stay, desire > 0.0, desire >= 0.0
    )
    # Who stands must be able to drive into the other lane, or it would stand in both.
    moves = (own.speed > CRAWL_M_PER_S) | (look.own_after > 0.5 * own.max_acceleration)
    # With half of the way left, who can still gain on the one behind does so first.
    early = (desire > COURTEOUS_DESIRE) & (desire < HASTY_DESIRE)
    gains = acceleration > 0.25 * own.max_acceleration
    waits = early & gains & look.has_follower & (own.speed < EVEN_SPEED * look.follower.speed)
    # One that comes over from there is let in; nobody who need not changes places with it.
    crosses = (look.stake > 0.0) & (desire <= 0.0)
    goes = wish.may & _is_safe(look, params, tyres) & wants & moves & ~waits & ~crosses

    concerned = look.has_leader & (look.stake > COURTEOUS_DESIRE)
    courtesy = _courtesy(own, look.leader, look.own_after, concerned, desire <= 0.0, params)
    return jnp.where(goes, GOES, courtesy)
