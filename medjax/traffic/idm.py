"""The Intelligent Driver Model: car-following acceleration (Treiber, Hennecke, Helbing 2000)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.numerics.shapes import Floats, Numbers
from medjax.numerics.sums import block_fma
from medjax.traffic.following import Drivers, Follower, braking_weight

# Lower bound of the gap s in s*/s, so that an overlap brakes hard instead of dividing by 0.
SMALLEST_GAP_M = 0.1


def idm_acceleration(
    speed: Numbers,
    gap: Numbers,
    leader_speed: Numbers,
    *,
    desired_speed: Numbers,
    time_headway: Numbers,
    min_gap: Numbers,
    max_acceleration: Numbers,
    comfortable_deceleration: Numbers,
    exponent: float = 4.0,
) -> Floats:
    """A [1 - (v/v0)^exponent - (s*/s)^2], s* = s0 + max(0, v T + v (v - v_leader) / (2 sqrt(a b))).

    Args:
      speed: m/s; all arguments broadcast together, any shape.
      gap: m, bumper to bumper; below 0.1 m it counts as 0.1 m. `following.FREE_GAP_M` for a free road.
      leader_speed: m/s.
      desired_speed: v0, m/s.
      time_headway: T, s.
      min_gap: s0, m.
      max_acceleration: a, m/s^2.
      comfortable_deceleration: b, m/s^2, positive.

    Returns:
      m/s^2, not limited from below.

    Source: Treiber and Kesting, Traffic Flow Dynamics, eqs (11.14)-(11.15), with s* clipped at s0.
    """
    speed = jnp.asarray(speed)
    free = free_acceleration(speed, desired_speed, max_acceleration, exponent)
    weight = braking_weight(max_acceleration, comfortable_deceleration)
    return free - interaction(
        speed, gap, leader_speed, time_headway, min_gap, max_acceleration, weight
    )


def free_acceleration(
    speed: jax.Array, desired_speed: ArrayLike, max_acceleration: ArrayLike, exponent: float
) -> jax.Array:
    """IDM acceleration on a free road: a [1 - (v/v0)^exponent], m/s^2."""
    ratio = speed / desired_speed
    # Two multiplications are cheaper than a pow.
    power = jnp.square(jnp.square(ratio)) if exponent == 4.0 else ratio**exponent
    return jnp.multiply(max_acceleration, 1.0 - power)


def interaction(
    speed: jax.Array,
    gap: ArrayLike,
    leader_speed: ArrayLike,
    time_headway: ArrayLike,
    min_gap: ArrayLike,
    max_acceleration: ArrayLike,
    weight: ArrayLike,
) -> jax.Array:
    """IDM's interaction term a (s*/s)^2, m/s^2; `weight` as from `following.braking_weight`."""
    braking = jnp.multiply(weight, speed * (speed - leader_speed))
    wanted = jnp.add(min_gap, jnp.maximum(0.0, block_fma(speed * time_headway) + braking))
    ratio = wanted / jnp.maximum(gap, SMALLEST_GAP_M)
    return block_fma(jnp.multiply(max_acceleration, jnp.square(ratio)))


def _interaction_of(follower: Follower, gap: jax.Array, leader_speed: ArrayLike) -> jax.Array:
    """`interaction` of followers."""
    _, speed, time_headway, min_gap, max_acceleration, weight, *_ = follower
    return interaction(speed, gap, leader_speed, time_headway, min_gap, max_acceleration, weight)


@dataclasses.dataclass(frozen=True)
class IDM:
    """IDM as a `CarFollowing`."""

    exponent: float = 4.0

    def prepare(self, drivers: Drivers, speed: jax.Array) -> jax.Array:
        """The acceleration on a free road, m/s^2."""
        desired_speed, max_acceleration = drivers.desired_speed, drivers.max_acceleration
        return free_acceleration(speed, desired_speed, max_acceleration, self.exponent)

    def acceleration(
        self, follower: Follower, gap: jax.Array, leader_speed: ArrayLike
    ) -> jax.Array:
        """`idm_acceleration`, m/s^2."""
        return follower.prepared - _interaction_of(follower, gap, leader_speed)


STANDARD_IDM = IDM()  # with the usual exponent


@dataclasses.dataclass(frozen=True)
class IDMPlus(IDM):
    """IDM+, min(free, a [1 - (s*/s)^2]): a steady follower keeps the gap s0 + v T at any speed.

    IDM adds both terms and near the desired speed never keeps its own headway, which makes a road's capacity a tenth
    too low. A vehicle above its desired speed brakes comfortably at most.

    Source: Schakel, van Arem, Netten 2010, eq (3); Schakel, Knoop, van Arem 2012.
    """

    def prepare(self, drivers: Drivers, speed: jax.Array) -> jax.Array:
        """The acceleration on a free road, m/s^2."""
        return jnp.maximum(super().prepare(drivers, speed), -drivers.comfortable_deceleration)

    def acceleration(
        self, follower: Follower, gap: jax.Array, leader_speed: ArrayLike
    ) -> jax.Array:
        """The smaller of the free and the following acceleration, m/s^2."""
        interacting = _interaction_of(follower, gap, leader_speed)
        return jnp.minimum(follower.prepared, follower.max_acceleration - interacting)


IDM_PLUS = IDMPlus()  # the default model
