"""Depleted EVs: an EV that runs out of energy coasts to the right shoulder, or stands in its lane until a tow comes.

From that moment on it has no booking and takes no charge. Braking does not recharge its battery. It counts as depleted,
not as arrived.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from medjax.physics import tractive_energy
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EVs, Vehicles

# Below this speed a vehicle counts as standing.
STANDING_M_PER_S = 0.1
# An EV this close to the centre of the rightmost lane can roll onto the shoulder.
SETTLED_M = 1.0


def coasting(speed: jax.Array, params: EnvParams) -> jax.Array:
    """Acceleration of EVs without motor power, m/s^2, at these speeds, m/s; from rolling, drag and slope of eq (7)."""
    body = params.ev
    v = jnp.maximum(speed, STANDING_M_PER_S)
    work = tractive_energy(
        v,
        v,
        1.0,
        mass=body.mass_kg,
        drag_coefficient=body.drag_coefficient,
        frontal_area=body.frontal_area_m2,
        rolling_resistance=body.rolling_resistance,
        slope=params.road.slope,
        air_density=params.road.air_density,
    )
    return -work / (v * body.mass_kg * body.rotational_inertia_factor)


def to_the_right(speed: jax.Array, params: EnvParams) -> jax.Array:
    """Desire of depleted EVs at these speeds, m/s, to go right: 1, or 0 if they would stop between two lanes.

    It is also 0 where depleted EVs block their lane (`depleted_blocks`).
    """
    rolling = -coasting(jnp.zeros((), jnp.float32), params)
    # This is the lateral distance until the EV stops, times 2 * rolling. The distance must exceed 1.5 lane widths,
    # because a lane change slows down towards its end.
    sideways = jnp.square(speed) * params.motion.lateral_slope
    comes_over = sideways > 2.0 * rolling * 1.5 * params.road.lane_width_m
    return jnp.where(comes_over & (params.charging.depleted_blocks == 0), 1.0, 0.0)


def without_motor(vehicles: Vehicles, evs: EVs, config: EnvConfig, params: EnvParams) -> Vehicles:
    """Removes acceleration noise, exit and courtesy from depleted EVs before a tick.

    A depleted EV cannot speed up again, so it does not brake to fall in behind a vehicle. It waits until the traffic
    beside it has passed or made room.
    """
    depleted = config.by_slot(False, evs.is_depleted, False)
    changes: dict[str, Any] = dict.fromkeys(("courtesy_left", "courtesy_right"), jnp.inf)
    changes["acceleration_noise"] = 0.0
    if config.num_exits:
        changes["destination"] = params.road.length_m
    for name, value in changes.items():
        new = jnp.where(depleted, value, getattr(vehicles, name))
        vehicles = vehicles.replace(**{name: new})
    return vehicles


def leaves_road(vehicles: Vehicles, evs: EVs, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Whether each depleted EV leaves the road after a tick, `(E,)` bool: onto the shoulder, or towed.

    Args:
      vehicles: after the tick; evs: before it, so that each depleted EV is on the road for at least a tick.
    """
    slots = config.ev_slots
    rightmost = vehicles.lane[slots] >= config.num_lanes - 1  # or on an acceleration lane
    settled = jnp.abs(vehicles.lateral_offset[slots]) < SETTLED_M
    on_shoulder = rightmost & settled & (params.charging.depleted_blocks == 0)
    stands = vehicles.speed[slots] < STANDING_M_PER_S
    return evs.is_depleted & (on_shoulder | stands & (evs.standing_s >= params.charging.tow_s))


def run_out(vehicles: Vehicles, evs: EVs, config: EnvConfig) -> tuple[EVs, jax.Array]:
    """Marks EVs that ran out of energy in a tick; `vehicles` is the state after it.

    Returns:
      The EVs, and which of them ran out, `(E,)` bool.
    """
    empty = vehicles.active[config.ev_slots] & (evs.energy_j <= 0.0) & ~evs.is_depleted
    stands = evs.is_depleted & (vehicles.speed[config.ev_slots] < STANDING_M_PER_S)
    standing_s = jnp.where(stands, evs.standing_s + config.tick_s, evs.standing_s)
    return evs.replace(is_depleted=evs.is_depleted | empty, standing_s=standing_s), empty
