"""Who follows whom how: IDM between any two vehicles, each with its own parameters."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.config import DriverParams, Scalar
from medjax.traffic.idm import FREE_GAP_M, idm_acceleration
from medjax.traffic.neighbours import NOBODY


class Drivers(NamedTuple):
    """What car following reads of each vehicle; every field `(N,)`."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    length: jax.Array  # m
    desired_speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    comfortable_deceleration: jax.Array  # m/s^2
    platoon: jax.Array  # int32, index of the MED it drives with, or NOBODY

    def at(self, slots: jax.Array) -> Drivers:
        """The drivers of those slots; NOBODY reads slot 0, to be masked by the caller."""
        index = jnp.maximum(slots, 0)
        return Drivers(*(field.at[index].get(mode="promise_in_bounds") for field in self))


class Platooning(NamedTuple):
    """Headway and standing gap between members of one platoon."""

    time_headway: Scalar  # s
    min_gap: Scalar  # m


def by_kind(kind: jax.Array, values: jax.Array) -> jax.Array:
    """values[kind], `(N,)` from `(num_kinds,)`."""
    return values.at[kind].get(mode="promise_in_bounds")


def make_drivers(
    x: jax.Array,
    speed: jax.Array,
    desired_speed: jax.Array,
    kind: jax.Array,
    platoon: jax.Array,
    params: DriverParams,
) -> Drivers:
    """Drivers of all slots, `(N,)` each, from their kinds' parameters."""
    return Drivers(
        x=x,
        speed=speed,
        length=by_kind(kind, params.vehicle_length),
        desired_speed=desired_speed,
        time_headway=by_kind(kind, params.time_headway),
        min_gap=by_kind(kind, params.min_gap),
        max_acceleration=by_kind(kind, params.max_acceleration),
        comfortable_deceleration=by_kind(kind, params.comfortable_deceleration),
        platoon=platoon,
    )


def gap_between(follower: Drivers, leader: Drivers) -> jax.Array:
    """Bumper gap, m; negative where they overlap."""
    return leader.x - leader.length - follower.x


def following_acceleration(
    follower: Drivers, leader: Drivers, has_leader: jax.Array, platooning: Platooning
) -> jax.Array:
    """IDM acceleration of each follower behind its leader, m/s^2, by the follower's parameters.

    Members of one platoon keep the platoon's headway and gap to each other: a MED and the EVs booked
    on it drive closer than strangers would.

    Args:
      follower, leader: equal shapes.
      has_leader: bool, that shape; False is a free road.
    """
    together = has_leader & (follower.platoon == leader.platoon) & (follower.platoon != NOBODY)
    return idm_acceleration(
        follower.speed,
        jnp.where(has_leader, gap_between(follower, leader), FREE_GAP_M),
        jnp.where(has_leader, leader.speed, follower.speed),
        desired_speed=follower.desired_speed,
        time_headway=jnp.where(together, platooning.time_headway, follower.time_headway),
        min_gap=jnp.where(together, platooning.min_gap, follower.min_gap),
        max_acceleration=follower.max_acceleration,
        comfortable_deceleration=follower.comfortable_deceleration,
    )


def obstacle_acceleration(driver: Drivers, distance: jax.Array) -> jax.Array:
    """IDM acceleration toward something that stands distance metres ahead, m/s^2."""
    return idm_acceleration(
        driver.speed,
        distance,
        0.0,
        desired_speed=driver.desired_speed,
        time_headway=driver.time_headway,
        min_gap=driver.min_gap,
        max_acceleration=driver.max_acceleration,
        comfortable_deceleration=driver.comfortable_deceleration,
    )
