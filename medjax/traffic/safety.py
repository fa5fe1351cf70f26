"""Safety bound: every vehicle can always stop behind its leader.

Car-following models keep comfortable distances, but none is safe for every leader, headway and tick length. This bound
complements them: if the leader brakes from now on as hard as tyres allow, the follower, who reacts a tick later, stops
behind it. A vehicle that satisfies the bound once can satisfy it for ever, also when its leader leaves the lane and
uncovers the next one. In ordinary traffic the bound does not bind.

Source: the safe speed of Gipps 1981, eq (6), and of Krauss, Wagner, Gawron 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.traffic.motion import FAR_M, stopping_acceleration
from medjax.world.params import Scalar

# Gap between two standing vehicles: more than the float32 rounding of positions on the longest road.
CLEARANCE_M = 0.05


class BrakingLimits(NamedTuple):
    """Limits of everyone's braking."""

    braking: Scalar  # m/s^2, maximum
    tick_s: float  # reaction time


def stopping_room(gap: jax.Array, leader_speed: jax.Array, limits: BrakingLimits) -> jax.Array:
    """Distance to where a leader stops if it brakes from now on, m; gap m, leader_speed m/s, equal shapes."""
    return gap - CLEARANCE_M + jnp.square(leader_speed) * (0.5 / limits.braking)


def safe_acceleration(speed: jax.Array, room: jax.Array, limits: BrakingLimits) -> jax.Array:
    """Highest acceleration, m/s^2, that lets a vehicle stop within its `stopping_room`, m; speed m/s, equal shapes."""
    return stopping_acceleration(speed, room, limits.braking, limits.tick_s)


def can_follow_safely(
    speed: jax.Array,
    max_acceleration: jax.Array,
    gap: jax.Array,
    leader_speed: jax.Array,
    limits: BrakingLimits,
) -> jax.Array:
    """Whether a vehicle can become this leader's follower in this tick, bool; max_acceleration in m/s^2."""
    after = speed + max_acceleration * limits.tick_s
    distance = 0.5 * limits.tick_s * (speed + after)
    braked = (jnp.square(after) - jnp.square(leader_speed)) * (0.5 / limits.braking)
    return gap - CLEARANCE_M >= distance + braked


def safe_speed(gap: jax.Array, leader_speed: jax.Array, braking: Scalar) -> jax.Array:
    """Highest speed, m/s, that satisfies the bound at a gap, m, to a leader, m/s."""
    # For gradients, the room is finite and the argument of the root positive.
    room = jnp.clip(gap - CLEARANCE_M, 0.0, FAR_M)
    return jnp.sqrt(jnp.maximum(jnp.square(leader_speed) + 2.0 * braking * room, 1e-6))
