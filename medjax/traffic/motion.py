"""Vehicle motion in one tick: ballistic along the road, steered within comfort limits across it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.errors import former_names
from medjax.numerics.shapes import Arrays, Floats

FAR_M = 1e12  # farther than any road is long
__getattr__ = former_names(
    __name__, crossing_s="lateral_travel_time", turn_between="heading_difference"
)


def ballistic_step(
    x: Arrays, speed: Arrays, acceleration: Arrays, dt: float
) -> tuple[Floats, Floats]:
    """Constant acceleration over a tick; a vehicle that would reverse stops instead.

    Args:
      x: m; speed: m/s, >= 0; acceleration: m/s^2; equal shapes.
      dt: s.

    Returns:
      (x, speed) after the tick.

    Source: Treiber and Kanagaraj 2015, ballistic update with the stop rule.
    """
    faster = speed + acceleration * dt
    stops = faster < 0.0
    # The divisor is replaced where the vehicle does not stop, so that no 0/0 reaches a gradient. Elsewhere it stays
    # above the subnormal numbers that a processor flushes to 0.
    braking = jnp.where(stops, jnp.maximum(-acceleration, 1e-12), 1.0)
    stopping = 0.5 * speed**2 / braking
    travel = jnp.where(stops, stopping, speed * dt + 0.5 * acceleration * dt**2)
    return x + travel, jnp.maximum(faster, 0.0)


def stopping_acceleration(
    speed: jax.Array, distance: jax.Array, braking: jax.Array | float, dt: float
) -> jax.Array:
    """Highest acceleration that lets a vehicle stop within a distance, m/s^2; binds only within braking distance.

    Args:
      speed: m/s; distance: m; braking: m/s^2, positive, of the stop; equal shapes.
      dt: s, reaction time.

    Source: the safe speed of Gipps 1981, eq (6), before a standing obstacle.
    """
    lag = 0.5 * braking * dt
    # Bounded, because a parameter times infinity would make a gradient NaN.
    spare = jnp.minimum(2.0 * distance - speed * dt, FAR_M)
    within = jnp.sqrt(jnp.square(lag) + braking * jnp.maximum(spare, 0.0)) - lag - speed
    at_once = -0.5 * jnp.square(speed) / jnp.maximum(distance, 1e-6)  # stops within the tick
    return jnp.where(spare > 0.0, within / dt, at_once)


class Steering(NamedTuple):
    """Limits of lateral motion; scalars, or one value per vehicle."""

    rate: jax.Array | float  # 1/s
    acceleration: jax.Array | float  # m/s^2, lateral maximum
    speed: jax.Array | float  # m/s, lateral maximum


def lateral_step(
    offset: jax.Array, lateral_speed: jax.Array, aim: jax.Array, steering: Steering, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Steers towards an aim for one tick, within lateral limits.

    The wanted lateral speed is half the rate times the distance to the aim, and it is approached at twice the rate:
    where no limit binds, the critically damped relaxation y'' = -rate^2 (y - aim) - 2 rate y'. The wanted speed is also
    low enough that half of the lateral acceleration can stop the vehicle at the aim; otherwise weak steering would
    swing into the next lane.

    Args:
      offset, aim: m; lateral_speed: m/s; equal shapes.
      dt: s.

    Returns:
      (offset, lateral_speed) after the tick.
    """
    ahead = offset + 0.5 * dt * lateral_speed  # half a tick ahead, or coarse ticks would overshoot
    distance = aim - ahead
    max_change = steering.acceleration * dt
    stops = (
        jnp.sqrt(jnp.square(0.5 * max_change) + steering.acceleration * jnp.abs(distance))
        - 0.5 * max_change
    )
    fastest = jnp.minimum(steering.speed, stops)
    wanted = jnp.clip(0.5 * steering.rate * distance, -fastest, fastest)
    gained = jnp.clip(
        (wanted - lateral_speed) * -jnp.expm1(-2.0 * steering.rate * dt), -max_change, max_change
    )
    # Longitudinal speed may fall faster than lateral comfort allows, and a standing vehicle must not slide.
    after = jnp.clip(lateral_speed + gained, -steering.speed, steering.speed)
    return offset + 0.5 * (lateral_speed + after) * dt, after


def lateral_travel_time(distance: jax.Array, steering: Steering) -> jax.Array:
    """Time to move sideways by `distance`, m, from straight driving, s, of the shape of the steering's speed."""
    return distance / steering.speed + 0.5 * steering.speed / steering.acceleration


def heading_difference(
    speed: jax.Array,
    lateral_speed: jax.Array,
    other_speed: jax.Array,
    other_lateral_speed: jax.Array,
) -> jax.Array:
    """Heading of the other vehicle minus that of this one, rad, positive to the right.

    A longitudinal speed of at least 1 m/s keeps a crawling vehicle from turning. The turn is at most a right angle.
    """
    along, other_along = jnp.maximum(speed, 1.0), jnp.maximum(other_speed, 1.0)
    cross = along * other_lateral_speed - lateral_speed * other_along
    dot = along * other_along + lateral_speed * other_lateral_speed
    half = cross / (jnp.sqrt(cross**2 + dot**2) + dot)  # tan(turn / 2)
    return 2.0 * _arctan(jnp.clip(half, -1.0, 1.0))


def _arctan(x: jax.Array) -> jax.Array:
    """Arctangent of x in [-1, 1] to 2e-8 and rounding (Abramowitz and Stegun, eq. 4.4.49).

    XLA for CPUs calls the C library for each arctangent; a polynomial vectorises and is thirty times as fast.
    """
    even = (
        *(0.0028662257, -0.0161657367, 0.0429096138, -0.0752896400),
        *(0.1065626393, -0.1420889944, 0.1999355085, -0.3333314528),
    )
    square = jnp.square(x)
    series = jnp.zeros_like(x)
    for coefficient in even:
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
