"""How vehicles move in one tick: ballistic along the road, steered within comfort across it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

FAR_M = 1e12  # beyond everything on a road


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


def stopping_acceleration(
    speed: jax.Array, distance: jax.Array, braking: jax.Array | float, dt: float
) -> jax.Array:
    """The most that lets a vehicle stop within a distance, m/s^2; it binds within braking distance only.

    Args:
      speed: m/s; distance: m; braking: m/s^2, positive, at which it means to stop; equal shapes.
      dt: s, in which it cannot change its mind.

    Source: the safe speed of Gipps 1981, eq (6), before an obstacle that stands.
    """
    lag = 0.5 * braking * dt
    # However far an obstacle is, or if there is none: a parameter times infinity would make a gradient NaN.
    spare = jnp.minimum(2.0 * distance - speed * dt, FAR_M)
    within = jnp.sqrt(jnp.square(lag) + braking * jnp.maximum(spare, 0.0)) - lag - speed
    at_once = -0.5 * jnp.square(speed) / jnp.maximum(distance, 1e-6)  # before the tick ends
    return jnp.where(spare > 0.0, within / dt, at_once)


class Steering(NamedTuple):
    """How vehicles move across the road; scalars, or one a vehicle."""

    rate: jax.Array | float  # 1/s
    acceleration: jax.Array | float  # m/s^2, sideways, at most
    speed: jax.Array | float  # m/s, sideways, at most


def lateral_step(
    offset: jax.Array, lateral_speed: jax.Array, aim: jax.Array, steering: Steering, dt: float
) -> tuple[jax.Array, jax.Array]:
    """A tick of steering to an aim, within what comfort and the speed along allow.

    Half of the rate times the way to go is the speed wanted, and twice the rate the speed's own rate: the
    critically damped relaxation y'' = -rate^2 (y - aim) - 2 rate y' where no limit holds. And no speed is wanted that
    half of the sideways acceleration would not take off on the way, or weak steering would swing into the next lane.

    Args:
      offset, aim: m; lateral_speed: m/s; equal shapes.
      dt: s.

    Returns:
      (offset, lateral_speed) after the tick.
    """
    ahead = offset + 0.5 * dt * lateral_speed  # half a tick on, or coarse ticks would overshoot
    way = aim - ahead
    most = steering.acceleration * dt
    stops = jnp.sqrt(jnp.square(0.5 * most) + steering.acceleration * jnp.abs(way)) - 0.5 * most
    fastest = jnp.minimum(steering.speed, stops)
    wanted = jnp.clip(0.5 * steering.rate * way, -fastest, fastest)
    gained = jnp.clip((wanted - lateral_speed) * -jnp.expm1(-2.0 * steering.rate * dt), -most, most)
    # The speed along may fall faster than comfort allows: who stands does not slide.
    after = jnp.clip(lateral_speed + gained, -steering.speed, steering.speed)
    return offset + 0.5 * (lateral_speed + after) * dt, after


def crossing_s(way: jax.Array, steering: Steering) -> jax.Array:
    """How long so much way across the road, m, takes from straight ahead, s, of the shape of the steering's speed."""
    return way / steering.speed + 0.5 * steering.speed / steering.acceleration


def turn_between(
    speed: jax.Array,
    lateral_speed: jax.Array,
    other_speed: jax.Array,
    other_lateral_speed: jax.Array,
) -> jax.Array:
    """Heading of the other vehicle less that of this one, rad, positive to the right.

    Both head where they drive, but a crawl, below 1 m/s, does not turn a vehicle. A turn of more than a
    right angle counts as one.
    """
    along, other_along = jnp.maximum(speed, 1.0), jnp.maximum(other_speed, 1.0)
    cross = along * other_lateral_speed - lateral_speed * other_along
    dot = along * other_along + lateral_speed * other_lateral_speed
    half = cross / (jnp.sqrt(cross**2 + dot**2) + dot)  # tan(turn / 2)
    return 2.0 * _arctan(jnp.clip(half, -1.0, 1.0))


def _arctan(x: jax.Array) -> jax.Array:
    """Arctangent of x in [-1, 1] to 2e-8 and rounding (Abramowitz and Stegun, eq. 4.4.49).

    XLA for CPUs calls the C library for each arctangent; a polynomial runs on vectors, thirty times as
    fast.
    """
    even = (
        -0.3333314528,
        0.1999355085,
        -0.1420889944,
        0.1065626393,
        -0.0752896400,
        0.0429096138,
        -0.0161657367,
        0.0028662257,
    )
    square = jnp.square(x)
    series = jnp.zeros_like(x)
    for coefficient in reversed(even):
        series = (series + coefficient) * square
    return x + x * series


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
