"""How long EVs need to reach a charging slot, as docking drives them."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.docking import ENTRY_ROOM_M, Partner, charging_slot_x, room_ahead
from medjax.world.params import FRONT, ChargingParams

# Approximate duration of a lane change, for the choice of a charging slot.
LANE_CHANGE_S = 4.0


def approach_time(way_m: jax.Array, fastest: jax.Array, params: ChargingParams) -> jax.Array:
    """Time in which an EV comes within `dock_tolerance_m` of its slot, s.

    It drives at its highest speed until its pace falls with the way that is left. From there on the error decays as the
    slower solution of the equation in `medjax.charging.docking.docking_acceleration`.

    Args:
      way_m: m, at least 0.
      fastest: m/s, highest speed relative to the MED; same shape.
    """
    steady, error_m = _steady_part(way_m, fastest, params)
    return steady + _settling_time(error_m, params.dock_tolerance_m, params)


def _steady_part(
    way_m: jax.Array, fastest: jax.Array, params: ChargingParams
) -> tuple[jax.Array, jax.Array]:
    """The part of an approach at the highest speed: its time, s, and the error that it leaves, m."""
    slows_at = jnp.maximum(fastest / params.approach_rate, params.dock_tolerance_m)
    steady = jnp.maximum(way_m - slows_at, 0.0) / jnp.maximum(fastest, 1e-3)
    return steady, jnp.minimum(way_m, slows_at)


def gentle_delay(
    x: jax.Array,
    lane: jax.Array,
    ev_length: jax.Array,
    med: Partner,
    fastest: jax.Array,
    gentle_rate: jax.Array,
    params: ChargingParams,
) -> jax.Array:
    """What EVs ahead need beyond `approach_time` and lane changes to fall back to the front slot, s; 0 for EVs behind.

    An EV in the MED's lane falls back so gently that the MED keeps its speed. An EV in the lane beside falls back
    gently only in the last metres, while it changes lanes, so its delay may be negative. If `room_ahead` in the slot is
    below minus the tolerance, an EV never gets there, and the delay is infinite.

    Args:
      x, lane, ev_length: of the EVs, equal shapes; med: their MEDs.
      fastest: m/s, their highest speed of falling back to this slot.
      gentle_rate: 1/s, see `medjax.charging.docking.gentle_rate`; both of the EVs' shape.
    """
    slot = charging_slot_x(jnp.int32(FRONT), med, ev_length, params.dock_gap_m)
    down, in_lane = x - slot, lane == med.lane
    in_change = jnp.where(in_lane, 0.0, LANE_CHANGE_S)
    beside = jnp.clip(ENTRY_ROOM_M - 0.5 * LANE_CHANGE_S * fastest, 0.0, down)
    last = jnp.where(in_lane, down, beside)
    steady, error_m = _steady_part(last, fastest, params)
    room_m = room_ahead(slot, ev_length, med, params)
    # From here on the pace falls faster with the way than with the room.
    settles_at = room_m * gentle_rate / jnp.maximum(params.approach_rate - gentle_rate, 1e-3)
    settles_at = jnp.maximum(settles_at, params.dock_tolerance_m)
    share = (last + room_m) / jnp.maximum(settles_at + room_m, 1e-3)
    gently = jnp.log(jnp.maximum(share, 1.0)) / gentle_rate
    # Both ways end with the same decay. They differ in the error from which it starts.
    gently += _settling_time(jnp.minimum(last, settles_at), error_m, params)
    gently = jnp.where(room_m > -params.dock_tolerance_m, gently, jnp.inf)
    return jnp.where(down > 0.0, jnp.maximum(gently - steady, 0.0) - in_change, 0.0)


def _settling_time(from_m: jax.Array, to_m: jax.Array | float, params: ChargingParams) -> jax.Array:
    """Time in which an error decays from `from_m` to `to_m`, s; negative if it would grow.

    Both errors are in m and count as `dock_tolerance_m` at least.
    """
    damping = jnp.maximum(1.0 - 4.0 * params.approach_rate / params.speed_rate, 0.0)
    decay = 0.5 * params.speed_rate * (1.0 - jnp.sqrt(damping))
    tolerance = params.dock_tolerance_m
    return jnp.log(jnp.maximum(from_m, tolerance) / jnp.maximum(to_m, tolerance)) / decay
