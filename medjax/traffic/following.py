"""Who follows whom how: IDM between any two vehicles, each with its own parameters."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from medjax.numerics.gathers import read
from medjax.traffic.idm import (
    FREE_GAP_M,
    braking_weight,
    free_acceleration,
    interaction,
    wanted_gap,
)
from medjax.traffic.neighbours import NOBODY
from medjax.world.params import DriverParams, Scalar

T = TypeVar("T")


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
    braking_weight: jax.Array  # s^2/m, idm.braking_weight


class Follower(NamedTuple):
    """What car following reads of the one who follows; every field of one shape."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    free_acceleration: jax.Array  # m/s^2, with nobody ahead
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m
    max_acceleration: jax.Array  # m/s^2
    braking_weight: jax.Array  # s^2/m
    platoon: jax.Array  # int32, index of the MED it drives with, or NOBODY


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


def make_drivers(kind: jax.Array, desired_speed: jax.Array, params: DriverParams) -> Drivers:
    """Drivers of all slots by their kinds' parameters.

    Args:
      kind: (N,) int32; desired_speed: (N,) m/s.
    """
    max_acceleration = by_kind(kind, params.max_acceleration)
    comfortable_deceleration = by_kind(kind, params.comfortable_deceleration)
    return Drivers(
        length=by_kind(kind, params.vehicle_length),
        desired_speed=desired_speed,
        time_headway=by_kind(kind, params.time_headway),
        min_gap=by_kind(kind, params.min_gap),
        max_acceleration=max_acceleration,
        comfortable_deceleration=comfortable_deceleration,
        braking_weight=braking_weight(max_acceleration, comfortable_deceleration),
    )


def roles(
    drivers: Drivers, x: jax.Array, speed: jax.Array, platoon: jax.Array
) -> tuple[Leader, Follower]:
    """All vehicles as they are seen from behind, and as they follow; every array `(N,)`."""
    leader = Leader(x - drivers.length, speed, platoon)
    follower = Follower(
        x=x,
        speed=speed,
        free_acceleration=free_acceleration(
            speed,
            desired_speed=drivers.desired_speed,
            max_acceleration=drivers.max_acceleration,
        ),
        time_headway=drivers.time_headway,
        min_gap=drivers.min_gap,
        max_acceleration=drivers.max_acceleration,
        braking_weight=drivers.braking_weight,
        platoon=platoon,
    )
    return leader, follower


def gap_between(follower: Follower, leader: Leader) -> jax.Array:
    """Bumper gap, m; negative where they overlap."""
    return leader.rear - follower.x


def following_acceleration(
    follower: Follower, leader: Leader, has_leader: jax.Array, platooning: Platooning
) -> jax.Array:
    """IDM acceleration of each follower behind its leader, m/s^2, by the follower's parameters.

    Members of one platoon keep the platoon's headway and gap to each other: a MED and the EVs booked
    on it drive closer than strangers would.

    Args:
      follower, leader: equal shapes.
      has_leader: bool, that shape; False is a free road.
    """
    together = has_leader & (follower.platoon == leader.platoon) & (follower.platoon != NOBODY)
    wanted = wanted_gap(
        follower.speed,
        jnp.where(has_leader, leader.speed, follower.speed),
        time_headway=jnp.where(together, platooning.time_headway, follower.time_headway),
        min_gap=jnp.where(together, platooning.min_gap, follower.min_gap),
        braking_weight=follower.braking_weight,
    )
    gap = jnp.where(has_leader, gap_between(follower, leader), FREE_GAP_M)
    return follower.free_acceleration - interaction(wanted, gap, follower.max_acceleration)


def obstacle_acceleration(driver: Follower, distance: jax.Array) -> jax.Array:
    """IDM acceleration toward something that stands distance metres ahead, m/s^2."""
    wanted = wanted_gap(
        driver.speed,
        0.0,
        time_headway=driver.time_headway,
        min_gap=driver.min_gap,
        braking_weight=driver.braking_weight,
    )
    return driver.free_acceleration - interaction(wanted, distance, driver.max_acceleration)
