"""The Intelligent Driver Model: car-following acceleration (Treiber, Hennecke, Helbing 2000)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

# Bumper gaps are not let below this in s*/s, so that an overlap brakes hard instead of dividing by 0.
SMALLEST_GAP_M = 0.1
# The gap of a vehicle with nobody ahead: far enough that (s*/s)^2 is lost in float32 rounding.
FREE_GAP_M = 1.0e6


def idm_acceleration(
    speed: ArrayLike,
    gap: ArrayLike,
    leader_speed: ArrayLike,
    *,
    desired_speed: ArrayLike,
    time_headway: ArrayLike,
    min_gap: ArrayLike,
    max_acceleration: ArrayLike,
    comfortable_deceleration: ArrayLike,
    exponent: float = 4.0,
) -> jax.Array:
    """A [1 - (v/v0)^exponent - (s*/s)^2], s* = s0 + max(0, v T + v (v - v_leader) / (2 sqrt(a b))).

    Args:
      speed: m/s; all arguments broadcast together, any shape.
      gap: m, bumper to bumper; below 0.1 m it counts as 0.1 m. FREE_GAP_M for a free road.
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
    speed, gap = jnp.asarray(speed), jnp.asarray(gap)
    approach = speed * (speed - leader_speed)
    approach = approach / (2.0 * jnp.sqrt(jnp.multiply(max_acceleration, comfortable_deceleration)))
    wanted_gap = min_gap + jnp.maximum(0.0, speed * time_headway + approach)
    interaction = wanted_gap / jnp.maximum(gap, SMALLEST_GAP_M)
    ratio = speed / desired_speed
    # The usual exponent is 4: two multiplications instead of a pow.
    free = jnp.square(jnp.square(ratio)) if exponent == 4.0 else ratio**exponent
    return jnp.multiply(max_acceleration, 1.0 - free - jnp.square(interaction))
