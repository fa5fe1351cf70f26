"""The highway: lanes 0 (leftmost) to num_lanes - 1, and acceleration lanes, index num_lanes."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.params import RoadParams

# Of what keeps a vehicle within its lane, how much its driver wanders at most.
WANDERS = 0.5
NOWHERE = -2  # a lane that there is none of, nor beside any


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


def spare_width(width: jax.Array, lane_width_m: jax.Array | float) -> jax.Array:
    """How far off its lane's centre a vehicle of this width, m, still is within its lane, m, at least 0."""
    return jnp.maximum(0.5 * (lane_width_m - width), 0.0)


def keeps_lane(aim: jax.Array, width: jax.Array, lane_width_m: jax.Array | float) -> jax.Array:
    """Offsets that drivers aim at, m, cut to WANDERS of what keeps vehicles as wide as that, m, in their lanes."""
    most = WANDERS * spare_width(width, lane_width_m)
    return jnp.clip(aim, -most, most)


def other_lane(
    lane: jax.Array, offset: jax.Array, width: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """The second lane that each vehicle covers, since it straddles a line, int32; NOWHERE for one within its lane.

    Args:
      lane: int32; offset: m from its centre, positive to the right; width: of the vehicle, m; one shape.
    """
    straddles = jnp.abs(offset) > spare_width(width, lane_width_m)
    return jnp.where(straddles, lane + jnp.sign(offset).astype(jnp.int32), NOWHERE)


def lateral_position(
    lane: jax.Array, offset: jax.Array, lane_width_m: jax.Array | float
) -> jax.Array:
    """Metres right of the leftmost lane's centre."""
    return lane * lane_width_m + offset
