"""Lane changes: all vehicles decide at once and look to one side per tick.

All lane changes of a tick go to the same side. Two vehicles that enter the same lane therefore come from the same
lane, where they already keep their distance, so nobody takes the same gap from two sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma
from medjax.traffic.following import Follower, Leader, gap_between, gather_slots
from medjax.traffic.mobil import is_safe, mobil_incentive
from medjax.traffic.neighbours import NOBODY, Neighbours
from medjax.traffic.safety import BrakingLimits, can_follow_safely
from medjax.world.params import LaneChangeParams

T = TypeVar("T")

# Below this speed a vehicle hardly moves sideways when it changes lanes.
CRAWL_M_PER_S = 2.0
# Other vehicles make room only for changes more urgent than this.
COURTEOUS_DESIRE = 0.3
# A less urgent mandatory change waits until the vehicle reaches EVEN_SPEED times its new follower's speed, as long as
# it can still accelerate.
HASTY_DESIRE = 0.6
EVEN_SPEED = 0.95


class LaneChangeIntent(NamedTuple):
    """What each vehicle intends: where to change lanes, and how urgently, `(N,)` each."""

    desire: jax.Array  # -1 to 1: negative to go left, positive to go right; size is urgency
    stay: jax.Array  # bool: only mandatory changes
    may_change: jax.Array  # bool: only traffic can prevent a change to the side looked at


class LaneChangePhase(NamedTuple):
    """Which of the `groups` equal parts of the slots looks to which side in a tick."""

    direction: jax.Array  # () int32, -1 left or +1 right
    group: jax.Array  # () int32
    groups: int


def lane_change_phase(tick: jax.Array, groups: int) -> LaneChangePhase:
    """Even ticks look left, odd ticks right; the active group changes every two ticks.

    Each vehicle thus looks once to either side in 2 * groups ticks, and a tick evaluates only one group.
    """
    return LaneChangePhase(jnp.where(tick % 2 == 0, -1, 1), tick // 2 % groups, groups)


def pick_group(tree: T, phase: LaneChangePhase) -> T:
    """Selects the active group: leaves (N,) to (ceil(N / groups),), padded with zeros."""

    def pick(values: jax.Array) -> jax.Array:
        parts = jnp.pad(values, (0, -values.shape[0] % phase.groups)).reshape(phase.groups, -1)
        return jax.lax.dynamic_index_in_dim(parts, phase.group, keepdims=False)

    return jax.tree.map(pick, tree)


def place_group(values: jax.Array, phase: LaneChangePhase, others: jax.Array) -> jax.Array:
    """Scatters the active group's values back into `others`, `(N,)`.

    XLA would fuse a select into each of its readers and recompute the whole decision there, but not a write.
    """
    num_vehicles = others.shape[0]
    parts = jnp.pad(others, (0, -num_vehicles % phase.groups)).reshape(phase.groups, -1)
    parts = jax.lax.dynamic_update_index_in_dim(parts, values, phase.group, axis=0)
    return parts.reshape(-1)[:num_vehicles]


class Situation(NamedTuple):
    """Traffic as all vehicles see it, and their reaction in their own lanes, `(N,)` each, by slot."""

    leaders: Leader
    followers: Follower
    usual_headway: jax.Array  # s, that drivers keep in the long run
    neighbours: Neighbours  # in the own lane and in the lane looked at
    clearing_s: jax.Array  # s, to clear the own lane when changing now
    following: jax.Array  # m/s^2, car following alone
    acceleration: jax.Array  # m/s^2, including all safety bounds and courtesy


Follow = Callable[[Follower, Leader, jax.Array], jax.Array]
"""Maps `(followers, leaders, has_leader)` of one shape to accelerations, m/s^2."""


# Marks a lane change in the result of `decide`; all other values are courtesy limits on the acceleration.
CHANGE_LANE = -jnp.inf


def _accepted_headway(usual: jax.Array, desire: jax.Array, params: LaneChangeParams) -> jax.Array:
    """Headway accepted at this urgency, s: LMRS, eq (10)."""
    shortest = jnp.minimum(params.accepted_headway, usual)
    return usual - block_fma((usual - shortest) * desire)


def _courtesy(
    own: Follower,
    leader: Leader,
    own_after: jax.Array,
    concerned: jax.Array,
    yields: jax.Array,
    params: LaneChangeParams,
) -> jax.Array:
    """Courtesy limit on the acceleration, m/s^2, towards the leader in the other lane; inf where not `concerned`.

    A vehicle that must change falls in behind that leader, and a vehicle that `yields` lets it in. Both brake within
    comfort only; a vehicle that would have to brake harder passes instead. A yielding vehicle brakes steadily from the
    start, since car following would brake late and then too hard.
    """
    closing_speed = jnp.maximum(own.speed - leader.speed, 0.0)
    gap = gap_between(own, leader)
    room = gap - 0.5 * own.min_gap
    # Of two equally fast vehicles side by side, the one behind falls back. A standing vehicle can do no more.
    drives = own.speed > CRAWL_M_PER_S
    even = closing_speed < 1.0
    needed = jnp.square(closing_speed) / (2.0 * jnp.maximum(room, 0.1))
    in_comfort = (room > 0.0) & (needed <= params.courtesy_braking)
    concerned &= drives & (gap < params.view_m) & (even | in_comfort)
    wanted = jnp.minimum(own_after, jnp.where(yields, -needed, jnp.inf))
    bounded = jnp.maximum(wanted, -params.courtesy_braking)
    return jnp.where(concerned, bounded, jnp.inf)


class TargetGaps(NamedTuple):
    """The gaps in the target lane that the active group looks at, and the vehicles around them, `(C,)` each."""

    own: Follower  # this vehicle, as it would follow in the target lane
    leader: Leader  # ahead in the target lane
    has_leader: jax.Array  # bool
    follower: Follower  # behind in the target lane, as it would follow this vehicle
    has_follower: jax.Array  # bool
    gap_behind: jax.Array  # m, inf without a follower
    old_leader: Leader  # ahead in the own lane
    old_gap: jax.Array  # m, to old_leader; inf without one
    clearing_s: jax.Array  # s, until this vehicle is out of its own lane
    desire: jax.Array  # -1 to 1, positive towards the side looked at
    urgency: jax.Array  # 0 to 1, of this vehicle's change or of one that comes over from there
    own_after: jax.Array  # m/s^2, in the target lane
    new_after: jax.Array  # m/s^2, of the new follower after the change
    others: tuple[jax.Array, ...]  # m/s^2, old follower before and after, then the new one


def _assess_gaps(
    situation: Situation,
    desire: jax.Array,
    phase: LaneChangePhase,
    follow: Follow,
    params: LaneChangeParams,
) -> TargetGaps:
    """What the active group sees in the target lane; desire `(N,)` is positive towards the side looked at."""
    leaders, followers, usual, neighbours, clearing_s, following, _ = situation
    mine = followers, usual, leaders, neighbours, clearing_s
    own, own_usual, seen, neighbours, clearing_s = pick_group(mine, phase)
    leader, leader_desire = gather_slots((leaders, desire), neighbours.target_leader)
    old_leader = gather_slots(leaders, neighbours.leader)
    behind = (followers, usual, following)
    follower, new_usual, new_before = gather_slots(behind, neighbours.target_follower)
    old_follower, old_before = gather_slots((followers, following), neighbours.follower)
    has_old_leader, has_old_follower, has_leader, has_follower = (
        slots != NOBODY for slots in neighbours
    )
    desire = pick_group(desire, phase)
    wanted = jnp.maximum(desire, 0.0)
    # The target leader can come over into the gap in front of this vehicle.
    open_to = has_leader & ~(has_old_leader & (old_leader.rear < leader.rear))
    # Or it stands: then the first vehicle that can stop for it lets it in, even if others still pass in between.
    open_to |= has_leader & (leader.speed < CRAWL_M_PER_S)
    open_to &= gap_between(own, leader) < params.view_m
    urgency = jnp.maximum(wanted, jnp.where(open_to, -leader_desire, 0.0))
    own = own._replace(time_headway=_accepted_headway(own_usual, urgency, params))
    follower = follower._replace(time_headway=_accepted_headway(new_usual, wanted, params))

    new_after = jnp.where(has_follower, follow(follower, seen, has_follower), 0.0)
    old_after = follow(old_follower, old_leader, has_old_leader)
    others = (
        jnp.where(has_old_follower, old_before, 0.0),
        jnp.where(has_old_follower, old_after, 0.0),
        jnp.where(has_follower, new_before, 0.0),
        new_after,
    )
    return TargetGaps(
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
        urgency=urgency,
        own_after=follow(own, leader, has_leader),
        new_after=new_after,
        others=others,
    )


def straddling_gap(own: Follower) -> jax.Array:
    """Gap that a vehicle leaving a lane keeps to its leader there, m: half of its standing gap."""
    return 0.5 * own.min_gap


def _is_safe(gaps: TargetGaps, params: LaneChangeParams, limits: BrakingLimits) -> jax.Array:
    """Whether each could change lanes safely, `(C,)` bool.

    The more urgent a change is, the harder it may make the vehicle and its new follower brake (LMRS's gap acceptance),
    and the smaller the gaps it accepts: it must fit in front of a vehicle that stops to let it in. However
    urgent the change, every vehicle must still be able to stop behind the one ahead. The changing vehicle covers both
    lanes until it has cleared its own; at current speeds it must do so before it reaches its old leader.
    """
    wanted = jnp.maximum(gaps.desire, 0.0)
    own, follower = gaps.own, gaps.follower
    ahead = jnp.where(gaps.has_leader, gap_between(own, gaps.leader), jnp.inf)
    clear = can_follow_safely(own.speed, own.max_acceleration, ahead, gaps.leader.speed, limits)
    behind = gaps.gap_behind
    clear &= can_follow_safely(follower.speed, follower.max_acceleration, behind, own.speed, limits)
    old_speed, old_gap = gaps.old_leader.speed, gaps.old_gap - straddling_gap(own)
    clear &= can_follow_safely(own.speed, own.max_acceleration, old_gap, old_speed, limits)
    closing_speed = jnp.maximum(jnp.maximum(own.speed, CRAWL_M_PER_S) - old_speed, 0.0)
    clear &= old_gap > closing_speed * gaps.clearing_s
    return clear & is_safe(
        gaps.own_after,
        gaps.new_after,
        ahead,
        behind,
        safe_braking=params.safe_braking * jnp.where(wanted > 0.0, wanted, 1.0),
        min_gap_ahead=own.min_gap * (1.0 - 0.5 * wanted),
        min_gap_behind=follower.min_gap * (1.0 - 0.5 * wanted),
    )


def decide(
    situation: Situation,
    intent: LaneChangeIntent,
    phase: LaneChangePhase,
    follow: Follow,
    params: LaneChangeParams,
    limits: BrakingLimits,
) -> jax.Array:
    """Decisions of the active group about the lane that it looks at, `(C,)`.

    Args:
      situation: of all vehicles.
      intent: mandatory changes add a bias to the incentive; they never waive safety.
      phase: the active group and the side looked at.
      follow: car following between any two vehicles.
      params: of lane changes; limits: bound on everyone's braking.

    Returns:
      CHANGE_LANE where the vehicle changes lanes now. Elsewhere the courtesy limit on its acceleration, m/s^2, towards
      the leader in that lane, inf for none. One array, because XLA would compute two one after the other.
    """
    gaps = _assess_gaps(situation, intent.desire * phase.direction, phase, follow, params)
    acceleration, intent = pick_group((situation.acceleration, intent), phase)
    own, desire = gaps.own, gaps.desire

    incentive = mobil_incentive(
        acceleration, gaps.own_after, *gaps.others, politeness=params.politeness
    )
    urgent = params.mandatory_bias + desire * params.urgency_bias
    bias = jnp.where(desire > 0.0, urgent, params.right_bias * phase.direction)
    wants = (incentive + bias > params.threshold) & jnp.where(
        intent.stay, desire > 0.0, desire >= 0.0
    )
    # A standing vehicle must be able to drive into the target lane, or it would block both.
    moves = (own.speed > CRAWL_M_PER_S) | (gaps.own_after > 0.5 * own.max_acceleration)
    # Early on, a vehicle that is slower than its new follower first accelerates if it can.
    early = (desire > COURTEOUS_DESIRE) & (desire < HASTY_DESIRE)
    gains = acceleration > 0.25 * own.max_acceleration
    waits = early & gains & gaps.has_follower & (own.speed < EVEN_SPEED * gaps.follower.speed)
    # A vehicle that lets another in does not swap places with it by a change of its own.
    crosses = (gaps.urgency > 0.0) & (desire <= 0.0)
    goes = intent.may_change & _is_safe(gaps, params, limits) & wants & moves & ~waits & ~crosses

    concerned = gaps.has_leader & (gaps.urgency > COURTEOUS_DESIRE)
    courtesy = _courtesy(own, gaps.leader, gaps.own_after, concerned, desire <= 0.0, params)
    return jnp.where(goes, CHANGE_LANE, courtesy)
