"""How vehicles move in one tick: ballistic along the road, critically damped across it."""

from __future__ import annotations

import jax
import jax.numpy as jnp


def ballistic_step(
    x: jax.Array, speed: jax.Array, acceleration: jax.Array, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Constant acceleration over a tick; who would reverse stands where it stops.

    Args:
      x: m; speed: m/s, >= 0; acceleration: m/s^2; equal shapes.
      dt: s.

    Returns:
      (x, speed) after the tick; speed >= 0 and x never decreases.

    Source: Treiber and Kanagaraj 2015, ballistic update with the stop rule.
    """
    faster = speed + acceleration * dt
    stops = faster < 0.0
    # Where nobody stops the divisor is replaced, so that no 0/0 reaches a gradient; and it is kept
    # off the numbers that a processor flushes to 0.
    braking = jnp.where(stops, jnp.maximum(-acceleration, 1e-12), 1.0)
    stopping = 0.5 * speed**2 / braking
    travel = jnp.where(stops, stopping, speed * dt + 0.5 * acceleration * dt**2)
    return x + travel, jnp.maximum(faster, 0.0)


def lateral_step(
    offset: jax.Array, lateral_speed: jax.Array, aim: jax.Array, rate: jax.Array | float, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Exact step of the critically damped relaxation y'' = -rate^2 (y - aim) - 2 rate y'.

    Args:
      offset, aim: m; lateral_speed: m/s; equal shapes.
      rate: 1/s; a change of one lane is 95 % done after 4.7 / rate.
      dt: s.

    Returns:
      (offset, lateral_speed) after the tick.
    """
    decay = jnp.exp(-rate * dt)
    error = offset - aim
    drive = lateral_speed + rate * error
    return (
        aim + (error + drive * dt) * decay,
        (lateral_speed - rate * drive * dt) * decay,
    )


def heading(speed: jax.Array, lateral_speed: jax.Array) -> jax.Array:
    """Angle of travel against the road, rad, positive to the right; a crawl does not turn it."""
    return jnp.arctan2(lateral_speed, jnp.maximum(speed, 1.0))


def ornstein_uhlenbeck(
    value: jax.Array, normal: jax.Array, std: jax.Array, time_s: jax.Array | float, dt: float
) -> jax.Array:
    """Exact step of a stationary Ornstein-Uhlenbeck process.

    Args:
      value: the process now; normal: standard normal draws, equal shapes.
      std: stationary standard deviation, in the units of value.
      time_s: correlation time, s; dt: s.
    """
    keep = jnp.exp(-dt / time_s)
    return keep * value + std * jnp.sqrt(1.0 - keep**2) * normal
