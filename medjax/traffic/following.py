"""Who follows whom how: a car-following model between any two vehicles, each with its own parameters."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.numerics.gathers import read
from medjax.numerics.sums import rounded
from medjax.traffic.neighbours import NOBODY
from medjax.world.kinds import WIDTHS_M
from medjax.world.params import DriverParams, LaneChangeParams, Scalar

T = TypeVar("T")

# The gap of a vehicle with nobody ahead: far enough that IDM's (s*/s)^2 is lost in float32 rounding.
FREE_GAP_M = 1.0e6


class Leader(NamedTuple):
    """What is seen of a vehicle from behind; every field of one shape."""

    rear: jax.Array  # m, rear bumper
    speed: jax.Array  # m/s
    platoon: jax.Array  # int32, index of the MED it drives with, or NOBODY


class Drivers(NamedTuple):
    """What car following reads of each vehicle that stays the same on its way; `(N,)` each."""

    length: jax.Array  # m
    desired_speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    comfortable_deceleration: jax.Array  # m/s^2
    closing: jax.Array  # s^2/m, `braking_weight`
    width: jax.Array  # m


class Follower(NamedTuple):
    """What car following reads of the one who follows; every field of one shape."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    closing: jax.Array  # s^2/m, headway per closing speed that comfortable braking takes
    prepared: Any  # by the model, `CarFollowing.prepare`
    platoon: jax.Array  # int32, index of the MED it drives with, or NOBODY


class CarFollowing(Protocol):
    """A car-following model, `ChargingEnv(following=...)`; `medjax.traffic.idm.IDM` is one.

    What depends on the follower alone is worked out once for all vehicles, not for each leader that it might
    have: a lane change looks at four pairs.
    """

    def prepare(self, drivers: Drivers, speed: jax.Array) -> Any:
        """A tree of `(N,)`, what the model makes of all vehicles at their speeds `(N,)` m/s, once a tick."""

    def acceleration(
        self, follower: Follower, gap: jax.Array, leader_speed: ArrayLike
    ) -> jax.Array:
        """Of a follower behind a leader, or something that stands, m/s^2, of the shape of the gap.

        Args:
          follower: its headway and standing gap are those that it keeps to this leader.
          gap: m, bumper to bumper; FREE_GAP_M on a free road, below 0 where they overlap.
          leader_speed: m/s; the follower's own on a free road.
        """


class Platooning(NamedTuple):
    """Headway and standing gap between members of one platoon."""

    time_headway: Scalar  # s
    min_gap: Scalar  # m


def by_kind(kind: jax.Array, values: jax.Array) -> jax.Array:
    """values[kind], `(N,)` from `(num_kinds,)`."""
    return read(values, kind)


def of_slots(vehicles: T, slots: jax.Array) -> T:
    """The leaders or followers of those slots; NOBODY reads slot 0, to be masked by the caller."""
    return read(vehicles, jnp.maximum(slots, 0))


def braking_weight(max_acceleration: ArrayLike, comfortable_deceleration: ArrayLike) -> jax.Array:
    """1 / (2 sqrt(a b)), s^2/m: times speed and closing speed, the distance that comfortable braking asks for."""
    return 0.5 / jnp.sqrt(jnp.multiply(max_acceleration, comfortable_deceleration))


def make_drivers(kind: jax.Array, desired_speed: jax.Array, params: DriverParams) -> Drivers:
    """Drivers of all slots by their kinds' parameters.

    Args:
      kind: (N,) int32; desired_speed: (N,) m/s.
    """
    closing = braking_weight(params.max_acceleration, params.comfortable_deceleration)
    return Drivers(
        length=by_kind(kind, params.vehicle_length),
        desired_speed=desired_speed,
        time_headway=by_kind(kind, params.time_headway),
        min_gap=by_kind(kind, params.min_gap),
        max_acceleration=by_kind(kind, params.max_acceleration),
        comfortable_deceleration=by_kind(kind, params.comfortable_deceleration),
        closing=by_kind(kind, closing),
        width=by_kind(kind, jnp.array(WIDTHS_M, jnp.float32)),
    )


def roles(
    drivers: Drivers, x: jax.Array, speed: jax.Array, platoon: jax.Array, model: CarFollowing
) -> tuple[Leader, Follower]:
    """All vehicles as they are seen from behind, and as they follow; every array `(N,)`."""
    leader = Leader(x - drivers.length, speed, platoon)
    follower = Follower(
        x=x,
        speed=speed,
        time_headway=drivers.time_headway,
        min_gap=drivers.min_gap,
        max_acceleration=drivers.max_acceleration,
        closing=drivers.closing,
        prepared=model.prepare(drivers, speed),
        platoon=platoon,
    )
    return leader, follower


def gap_between(follower: Follower, leader: Leader) -> jax.Array:
    """Bumper gap, m; negative where they overlap."""
    return leader.rear - follower.x


def same_platoon(follower: Follower, leader: Leader, has_leader: jax.Array) -> jax.Array:
    """Whether each drives with the one ahead of it, bool."""
    return has_leader & (follower.platoon == leader.platoon) & (follower.platoon != NOBODY)


def spare_headway(follower: Follower, leader: Leader, has_leader: jax.Array) -> jax.Array:
    """Headway that IDM finds kept as things are, s: the gap less s0 and what closing in takes, over the speed."""
    closing = jnp.maximum(follower.speed - leader.speed, 0.0) * follower.closing
    kept = (gap_between(follower, leader) - follower.min_gap) / jnp.maximum(follower.speed, 1.0)
    return jnp.where(has_leader, kept - closing, jnp.inf)


def relaxed_headway(
    headway: jax.Array,
    usual: jax.Array,
    spare: jax.Array,
    is_new: jax.Array,
    dt: float,
    params: LaneChangeParams,
) -> jax.Array:
    """Headways that drivers keep in this tick, s: a short one is accepted for a while and grows back.

    After a change of lanes, one's own or that of the vehicle ahead, a driver takes the headway that there is, down
    to the shortest accepted one. From then it relaxes to the usual one, and it is never shorter than what there is.

    Args:
      headway: (N,) s, so far; usual: (N,) s, each driver's own.
      spare: (N,) s, what there is (`spare_headway`).
      is_new: (N,) bool, this vehicle or the one ahead is changing lanes.

    Source: Laval and Leclercq 2008; Schakel, Knoop, van Arem 2012, eq (13).
    """
    there = jnp.minimum(spare, usual)
    short = jnp.minimum(headway, usual)
    share = jnp.minimum(dt / params.relaxation_s, 1.0)  # of what is missing
    grown = short + rounded((usual - short) * share)
    taken = jnp.maximum(there, jnp.minimum(params.accepted_headway, usual))
    return jnp.where(is_new, taken, jnp.maximum(grown, there))


def following_acceleration(
    follower: Follower,
    leader: Leader,
    has_leader: jax.Array,
    platooning: Platooning,
    model: CarFollowing,
) -> jax.Array:
    """Acceleration of each follower behind its leader, m/s^2, by the follower's parameters.

    Members of one platoon keep the platoon's headway and gap to each other: a MED and the EVs booked
    on it drive closer than strangers would.

    Args:
      follower, leader: equal shapes.
      has_leader: bool, that shape; False is a free road.
    """
    together = same_platoon(follower, leader, has_leader)
    keeps = follower._replace(
        time_headway=jnp.where(together, platooning.time_headway, follower.time_headway),
        min_gap=jnp.where(together, platooning.min_gap, follower.min_gap),
    )
    gap = jnp.where(has_leader, gap_between(follower, leader), FREE_GAP_M)
    return model.acceleration(keeps, gap, jnp.where(has_leader, leader.speed, follower.speed))
