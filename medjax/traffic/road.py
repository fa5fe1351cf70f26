"""Road geometry: lanes 0 (leftmost) to num_lanes - 1; all acceleration lanes have index num_lanes."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.params import RoadParams

# Wander is at most this share of a vehicle's spare width.
WANDER_SHARE = 0.5
NO_LANE = -2  # no lane, and not next to one


def merge_distance(x: jax.Array, road: RoadParams) -> jax.Array:
    """Metres from the front bumper to the end of the acceleration lane that x is on.

    Args:
      x: any shape, m; on an acceleration lane.
      road: with ramps further apart than an acceleration lane is long.

    Returns:
      The shape of x, m; inf past the last lane.
    """
    nearest = jnp.full_like(x, jnp.inf)
    # A loop over ramps: a minimum over an axis of ramps costs three times as much on a CPU.
    for ramp in range(road.ramp_x_m.shape[0]):
        to_end = road.ramp_x_m[ramp] + road.acceleration_lane_m - x
        # A bumper that rounds to just past the end still belongs to this lane, not to the next one.
        nearest = jnp.minimum(nearest, jnp.where(to_end >= -1.0, to_end, jnp.inf))
    return nearest


def spare_width(width: jax.Array, lane_width_m: jax.Array | float) -> jax.Array:
    """Largest offset from the lane's centre at which a vehicle of this width is within its lane, m, at least 0."""
    return jnp.maximum(0.5 * (lane_width_m - width), 0.0)


def clip_lateral_aim(
    aim: jax.Array, width: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """Clips drivers' lateral aims, m, to WANDER_SHARE times the spare width of their vehicles; width in m."""
    most = WANDER_SHARE * spare_width(width, lane_width_m)
    return jnp.clip(aim, -most, most)


def straddled_lane(
    lane: jax.Array, offset: jax.Array, width: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """The second lane that a straddling vehicle covers, int32; NO_LANE for a vehicle within its lane.

    Args:
      lane: int32; offset: m from its centre, positive to the right; width: of the vehicle, m; equal shapes.
    """
    straddles = jnp.abs(offset) > spare_width(width, lane_width_m)
    return jnp.where(straddles, lane + jnp.sign(offset).astype(jnp.int32), NO_LANE)


def lateral_position(
    lane: jax.Array, offset: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """Lateral position, m to the right of the leftmost lane's centre."""
    return lane * lane_width_m + offset
