"""The highway: lanes 0 (leftmost) to num_lanes - 1, and acceleration lanes, index num_lanes."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.params import RoadParams


def merge_distance(x: jax.Array, road: RoadParams) -> jax.Array:
    """Metres from the front bumper to the end of the acceleration lane that x is on.

    Args:
      x: any shape, m; on an acceleration lane.
      road: one whose ramps are further apart than an acceleration lane is long.

    Returns:
      The shape of x, m. The end is a standing obstacle.
    """
    nearest = jnp.full_like(x, jnp.inf)
    # One ramp after the other: a minimum over an axis of ramps costs three times as much on a CPU.
    for ramp in range(road.ramp_x_m.shape[0]):
        to_end = road.ramp_x_m[ramp] + road.acceleration_lane_m - x
        # A bumper that rounds to just past the end still belongs to that lane, not to the next one.
        nearest = jnp.minimum(nearest, jnp.where(to_end >= -1.0, to_end, jnp.inf))
    return nearest


def lateral_position(
    lane: jax.Array, offset: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """Metres right of the leftmost lane's centre."""
    return lane * lane_width_m + offset
