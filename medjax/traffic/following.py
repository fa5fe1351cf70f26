"""Car following: applies a model to any pair of vehicles, each with its own parameters."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.errors import renamed
from medjax.numerics.gathers import read
from medjax.numerics.sums import block_fma
from medjax.traffic.neighbours import NOBODY
from medjax.world.params import DriverParams, LaneChangeParams, Scalar

T = TypeVar("T")

# Gap on a free road: so large that IDM's (s*/s)^2 is lost in float32 rounding.
FREE_GAP_M = 1.0e6


class Leader(NamedTuple):
    """What a follower sees of its leader; all fields have the same shape."""

    rear: jax.Array  # m, rear bumper
    speed: jax.Array  # m/s
    platoon: jax.Array  # int32, index of the MED that it drives with, or NOBODY


class Drivers(NamedTuple):
    """Car-following data that stay constant between two rounds of entries, `(N,)` each."""

    length: jax.Array  # m
    desired_speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    comfortable_deceleration: jax.Array  # m/s^2
    braking_weight: jax.Array  # s^2/m, from the function of that name
    width: jax.Array  # m

    @property
    def closing(self) -> jax.Array:
        """Former name of `braking_weight`, for one more version."""
        return renamed("Drivers.closing", "braking_weight", self.braking_weight)


class Follower(NamedTuple):
    """What a model reads of the follower; all fields have the same shape."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    braking_weight: jax.Array  # s^2/m, extra headway per closing speed, for comfortable braking
    prepared: Any  # from `CarFollowing.prepare`
    platoon: jax.Array  # int32, index of the MED that it drives with, or NOBODY

    @property
    def closing(self) -> jax.Array:
        """Former name of `braking_weight`, for one more version."""
        return renamed("Follower.closing", "braking_weight", self.braking_weight)


class CarFollowing(Protocol):
    """A car-following model, `ChargingEnv(following=...)`; `medjax.traffic.idm.IDM` is one.

    A lane change evaluates four leader-follower pairs, so `prepare` computes once what depends on the follower alone.
    """

    def prepare(self, drivers: Drivers, speed: jax.Array) -> Any:
        """Precomputes a tree of `(N,)` for all vehicles at speeds `(N,)` m/s; called once per tick."""

    def acceleration(
        self, follower: Follower, gap: jax.Array, leader_speed: ArrayLike
    ) -> jax.Array:
        """Acceleration of a follower behind a leader or a standing obstacle, m/s^2, of the shape of the gap.

        Args:
          follower: with the headway and standing gap that it keeps to this leader.
          gap: m, bumper to bumper; FREE_GAP_M on a free road, negative for an overlap.
          leader_speed: m/s; the follower's own speed on a free road.
        """


class Platooning(NamedTuple):
    """Headway and standing gap between members of one platoon."""

    time_headway: Scalar  # s
    min_gap: Scalar  # m


def by_kind(kind: jax.Array, values: jax.Array) -> jax.Array:
    """values[kind], `(N,)` from `(num_kinds,)`."""
    return read(values, kind)


def gather_slots(vehicles: T, slots: jax.Array) -> T:
    """Gathers the data of the vehicles in these slots; NOBODY reads slot 0, which the caller masks."""
    return read(vehicles, jnp.maximum(slots, 0))


def braking_weight(max_acceleration: ArrayLike, comfortable_deceleration: ArrayLike) -> jax.Array:
    """1 / (2 sqrt(a b)), s^2/m; times speed and closing speed it gives the braking part of IDM's desired gap, m."""
    return 0.5 / jnp.sqrt(jnp.multiply(max_acceleration, comfortable_deceleration))


def make_drivers(kind: jax.Array, desired_speed: jax.Array, params: DriverParams) -> Drivers:
    """Looks up each slot's driver parameters by its kind.

    Args:
      kind: (N,) int32; desired_speed: (N,) m/s.
    """
    weight = braking_weight(params.max_acceleration, params.comfortable_deceleration)
    return Drivers(
        length=by_kind(kind, params.vehicle_length),
        desired_speed=desired_speed,
        time_headway=by_kind(kind, params.time_headway),
        min_gap=by_kind(kind, params.min_gap),
        max_acceleration=by_kind(kind, params.max_acceleration),
        comfortable_deceleration=by_kind(kind, params.comfortable_deceleration),
        braking_weight=by_kind(kind, weight),
        width=by_kind(kind, params.vehicle_width),
    )


def leaders_and_followers(
    drivers: Drivers, x: jax.Array, speed: jax.Array, platoon: jax.Array, model: CarFollowing
) -> tuple[Leader, Follower]:
    """Describes all vehicles as leaders and as followers; every array `(N,)`."""
    leader = Leader(x - drivers.length, speed, platoon)
    keeps = drivers.time_headway, drivers.min_gap, drivers.max_acceleration, drivers.braking_weight
    return leader, Follower(x, speed, *keeps, model.prepare(drivers, speed), platoon)


def gap_between(follower: Follower, leader: Leader) -> jax.Array:
    """Bumper-to-bumper gap, m; negative for an overlap."""
    return leader.rear - follower.x


def same_platoon(follower: Follower, leader: Leader, has_leader: jax.Array) -> jax.Array:
    """Whether follower and leader belong to one platoon, bool."""
    return has_leader & (follower.platoon == leader.platoon) & (follower.platoon != NOBODY)


def current_headway(follower: Follower, leader: Leader, has_leader: jax.Array) -> jax.Array:
    """Current IDM headway, s: (gap - s0) / v - max(0, v - v_leader) w, w the braking weight; inf without a leader."""
    braking = jnp.maximum(follower.speed - leader.speed, 0.0) * follower.braking_weight
    kept = (gap_between(follower, leader) - follower.min_gap) / jnp.maximum(follower.speed, 1.0)
    return jnp.where(has_leader, kept - braking, jnp.inf)


def relaxed_headway(
    headway: jax.Array,
    usual: jax.Array,
    current: jax.Array,
    is_new: jax.Array,
    dt: float,
    params: LaneChangeParams,
) -> jax.Array:
    """Headways that drivers keep in this tick, s.

    When a vehicle or its leader changes lanes, the driver accepts the current headway, down to the shortest accepted
    one. It then relaxes to the usual headway, and is never below the smaller of the current and the usual one.

    Args:
      headway: (N,) s, so far; usual: (N,) s, each driver's own.
      current: (N,) s, from `current_headway`.
      is_new: (N,) bool, this vehicle or the one ahead is changing lanes.

    Source: Laval and Leclercq 2008; Schakel, Knoop, van Arem 2012, eq (13).
    """
    lowest = jnp.minimum(current, usual)
    short = jnp.minimum(headway, usual)
    share = jnp.minimum(dt / params.relaxation_s, 1.0)  # of the missing headway
    relaxed = short + block_fma((usual - short) * share)
    accepted = jnp.maximum(lowest, jnp.minimum(params.accepted_headway, usual))
    return jnp.where(is_new, accepted, jnp.maximum(relaxed, lowest))


def following_acceleration(
    follower: Follower,
    leader: Leader,
    has_leader: jax.Array,
    platooning: Platooning,
    model: CarFollowing,
) -> jax.Array:
    """Acceleration of each follower behind its leader, m/s^2, by the follower's parameters.

    Members of a platoon, a MED and the EVs booked on it, keep the platoon's shorter headway and gap to each other.

    Args:
      follower, leader: equal shapes.
      has_leader: bool, of the same shape; False means a free road.
    """
    together = same_platoon(follower, leader, has_leader)
    keeps = follower._replace(
        time_headway=jnp.where(together, platooning.time_headway, follower.time_headway),
        min_gap=jnp.where(together, platooning.min_gap, follower.min_gap),
    )
    gap = jnp.where(has_leader, gap_between(follower, leader), FREE_GAP_M)
    return model.acceleration(keeps, gap, jnp.where(has_leader, leader.speed, follower.speed))
