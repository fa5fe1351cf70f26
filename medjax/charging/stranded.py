"""What becomes of an EV that runs out: it coasts to the right shoulder, or stands in its lane until it is towed.

It leaves the books the moment it runs out: it is neither booked nor charged, nothing comes into its battery by
braking, and it counts as depleted, not as one that arrives.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.physics import tractive_energy
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EVs, Vehicles

# Below this a vehicle stands.
STANDING_M_PER_S = 0.1
# So near to the middle of the rightmost lane an EV rolls on, onto the shoulder.
SETTLED_M = 1.0


def coasting(speed: jax.Array, params: EnvParams) -> jax.Array:
    """Acceleration of EVs at these speeds, m/s, without a motor, m/s^2: what rolling, drag and slope take, eq (7)."""
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
    """How urgently depleted EVs at these speeds, m/s, must go to the right, as `medjax.traffic.lane_change.Wish`.

    At once, or never: who would stand between two lanes, since the way that is left is too short for a change, stays.
    """
    rolling = -coasting(jnp.zeros((), jnp.float32), params)
    # Until it stands it comes so far to the side, over 2 * rolling, m; half a lane more than one must be left, since
    # the end of a change is slower.
    sideways = jnp.square(speed) * params.motion.lateral_slope
    comes_over = sideways > 2.0 * rolling * 1.5 * params.road.lane_width_m
    return jnp.where(comes_over & (params.charging.depleted_blocks == 0), 1.0, 0.0)


def without_motor(vehicles: Vehicles, evs: EVs, config: EnvConfig, params: EnvParams) -> Vehicles:
    """The vehicles before a tick: of depleted EVs no noise of a foot on the pedal, nor an exit.

    And none brakes to fall in: who cannot get faster again waits until traffic beside it has passed, or has made room.
    """
    slots = config.ev_slots
    noise = vehicles.acceleration_noise
    if config.num_exits:
        own, end = vehicles.destination, params.road.length_m
        bound = jnp.where(evs.is_depleted, end, own[slots])
        vehicles = vehicles.replace(destination=own.at[slots].set(bound))

    def of_depleted(values: jax.Array, value: float) -> jax.Array:
        return values.at[slots].set(jnp.where(evs.is_depleted, value, values[slots]))

    return vehicles.replace(
        acceleration_noise=of_depleted(noise, 0.0),
        courtesy_left=of_depleted(vehicles.courtesy_left, jnp.inf),
        courtesy_right=of_depleted(vehicles.courtesy_right, jnp.inf),
    )


def leaves_road(vehicles: Vehicles, evs: EVs, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Depleted EVs that are off the road after a tick, `(E,)` bool: on the shoulder, or towed away.

    Args:
      vehicles: after the tick; evs: before it, so that each is seen on the road without energy once.
    """
    slots = config.ev_slots
    rightmost = vehicles.lane[slots] >= config.num_lanes - 1  # an acceleration lane is, too
    settled = jnp.abs(vehicles.lateral_offset[slots]) < SETTLED_M
    on_shoulder = rightmost & settled & (params.charging.depleted_blocks == 0)
    return evs.is_depleted & (on_shoulder | (evs.timer_s >= params.charging.tow_s))


def run_out(vehicles: Vehicles, evs: EVs, config: EnvConfig) -> tuple[EVs, jax.Array]:
    """The EVs with those marked that ran out in a tick, and which did, `(E,)` bool; vehicles: after it."""
    empty = vehicles.active[config.ev_slots] & (evs.energy_j <= 0.0) & ~evs.is_depleted
    timer = jnp.where(empty, 0.0, evs.timer_s)
    stands = evs.is_depleted & (vehicles.speed[config.ev_slots] < STANDING_M_PER_S)
    timer = jnp.where(stands, timer + config.tick_s, timer)
    return evs.replace(is_depleted=evs.is_depleted | empty, timer_s=timer), empty
