"""What keeps vehicles apart whatever they do next: everyone can still stop behind the one ahead.

Car-following models keep comfortable distances, and none of them is a match for every leader, headway and tick that
may be asked for. So this bound stands beside them: should the one ahead brake from now on as hard as tyres can, the
one behind, who sees it a tick later, comes to a stop behind it. Who keeps to it once can keep to it ever after, and
so can who is behind when the one between them leaves the lane. In ordinary traffic it does not bind.

Source: the safe speed of Gipps 1981, eq (6), and of Krauss, Wagner, Gawron 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.traffic.motion import FAR_M, stopping_acceleration
from medjax.world.params import Scalar

# Left between two who stand, more than float32 rounds places to on the longest road.
CLEARANCE_M = 0.05


class Tyres(NamedTuple):
    """What bounds everyone's braking."""

    braking: Scalar  # m/s^2, at most
    tick_s: float  # in which nobody changes its mind


def stopping_room(gap: jax.Array, leader_speed: jax.Array, tyres: Tyres) -> jax.Array:
    """Way to where a leader would come to stand, m, if it braked from now on; gaps m and speeds m/s, equal shapes."""
    return gap - CLEARANCE_M + jnp.square(leader_speed) * (0.5 / tyres.braking)


def safe_acceleration(speed: jax.Array, room: jax.Array, tyres: Tyres) -> jax.Array:
    """The most, m/s^2, that still lets a vehicle stop within a `stopping_room`, m; speeds m/s, equal shapes."""
    return stopping_acceleration(speed, room, tyres.braking, tyres.tick_s)


def keeps_clear(
    speed: jax.Array, most: jax.Array, gap: jax.Array, leader_speed: jax.Array, tyres: Tyres
) -> jax.Array:
    """Whether one that may accelerate at `most`, m/s^2, can become the follower of a leader in this tick, bool."""
    after = speed + most * tyres.tick_s
    way = 0.5 * tyres.tick_s * (speed + after)
    braked = (jnp.square(after) - jnp.square(leader_speed)) * (0.5 / tyres.braking)
    return gap - CLEARANCE_M >= way + braked


def safe_speed(gap: jax.Array, leader_speed: jax.Array, braking: Scalar) -> jax.Array:
    """The highest speed, m/s, from which `safe_acceleration` can hold, at a gap, m, to a leader, m/s."""
    # Not infinite, or a gradient would be NaN; and the root above 0, where its gradient would have no end.
    room = jnp.clip(gap - CLEARANCE_M, 0.0, FAR_M)
    return jnp.sqrt(jnp.maximum(jnp.square(leader_speed) + 2.0 * braking * room, 1e-6))
