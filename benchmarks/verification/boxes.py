"""Finds overlapping vehicles by checking all pairs of boxes, for any simulator.

The check uses neither leaders nor lane changes: if it shared the simulator's view of positions, it would share its
faults. Bodies are boxes aligned with the road. The check ignores their small turns in a lane change.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from medjax.traffic.road import lateral_position
from medjax.world.params import EnvParams
from medjax.world.state import Vehicles

DEEP_M = 0.1  # along and across; a smaller overlap is rounding or a wing mirror


def overlapping(x: Any, lateral: Any, length: Any, width: Any, there: Any) -> Any:
    """Pairs of boxes that overlap by at least DEEP_M along and across, `(..., N, N)` bool, each pair once.

    Args:
      x, lateral: (..., N) m, of front bumpers, and of centres from any origin; all NumPy arrays or all JAX arrays.
      length, width: (..., N) m.
      there: (..., N) bool, occupied slots.
    """
    middle = x - 0.5 * length
    along, across = (
        0.5 * (size[..., :, None] + size[..., None, :]) - abs(at[..., :, None] - at[..., None, :])
        for size, at in ((length, middle), (width, lateral))
    )
    number = np.arange(x.shape[-1])
    once = number[:, None] < number
    both = there[..., :, None] & there[..., None, :] & once
    return (along >= DEEP_M) & (across >= DEEP_M) & both


def _bodies(vehicles: Vehicles, params: EnvParams) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Position across the road from the leftmost lane's centre, length and width in each slot, (N,) m each."""
    lateral = lateral_position(vehicles.lane, vehicles.lateral_offset, params.road.lane_width_m)
    drivers = params.drivers
    length, width = drivers.vehicle_length, drivers.vehicle_width
    return lateral, jnp.asarray(length)[vehicles.kind], jnp.asarray(width)[vehicles.kind]


def overlapping_vehicles(vehicles: Vehicles, params: EnvParams) -> jax.Array:
    """`overlapping` for the vehicles on a road, `(N, N)` bool."""
    return overlapping(vehicles.x, *_bodies(vehicles, params), vehicles.active)


def lanes_covered(vehicles: Vehicles, params: EnvParams) -> tuple[jax.Array, jax.Array]:
    """Leftmost and rightmost lane that each body reaches into by more than a millimetre, `(N,)` each."""
    lateral, _, width = _bodies(vehicles, params)
    reach, lane_width = 0.5 * width - 1e-3, params.road.lane_width_m
    left, right = ((lateral + side) / lane_width for side in (-reach, reach))
    return jnp.floor(left + 0.5), jnp.floor(right + 0.5)
