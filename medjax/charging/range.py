"""Eco-driving: drivers of EVs slow down when their charge does not last for their trip."""

import jax
import jax.numpy as jnp

from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams, Scalar
from medjax.world.state import NOT_BOOKED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2, as `medjax.physics.tractive_energy`
# Leaves an error below 0.5 % of the speed, largest where hardly any speed lasts, and none without auxiliaries.
NEWTON_STEPS = 6


def required_range(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Distance for which each EV's charge should last, `(E,)` m: to its exit; past the road's end, `eco_horizon_m`."""
    destination = vehicles.destination[config.ev_slots]
    left = destination - vehicles.x[config.ev_slots]
    beyond = jnp.maximum(left, params.drivers.eco_horizon_m)
    return jnp.where(destination < params.road.length_m, left, beyond)


def lasting_speed(
    energy_j: jax.Array,
    distance_m: jax.Array,
    desired_speed: jax.Array,
    eco_speed: Scalar,
    body: BodyParams,
    road: RoadParams,
) -> jax.Array:
    """Highest speed up to the desired one at which the charge lasts, or the most economical speed where none does.

    Energy per metre at a constant speed v is (c + k v^2) / eta + P / v by eq (7) and the drivetrain. Drivers slow down
    neither below the speed at which auxiliaries outweigh drag, nor below `eco_speed`.

    Args:
      energy_j, distance_m, desired_speed: (E,) J, m (inf: no charge is enough), m/s.
      eco_speed: m/s, lowest speed to save charge.

    Returns:
      (E,) m/s, at most desired_speed, and otherwise at least eco_speed.
    """
    drag = 0.5 * road.air_density * body.drag_coefficient * body.frontal_area_m2
    resistance = body.mass_kg * GRAVITY * (body.rolling_resistance + jnp.sin(road.slope))
    auxiliary = body.drivetrain_efficiency * body.auxiliary_w
    # The gradient of a root at 0 is infinite.
    slowest = jnp.maximum(eco_speed, jnp.cbrt(jnp.maximum(auxiliary / (2.0 * drag), 1e-12)))
    # Solves k v^3 + (c - eta E / way) v + eta P = 0 by Newton's method. The function is convex, so the steps descend
    # from the solution without auxiliaries.
    slope = resistance - body.drivetrain_efficiency * energy_j / jnp.maximum(distance_m, 1.0)
    rolls = slope < 0.0  # keeps 0 out of the root, for gradients
    alone = jnp.where(rolls, jnp.sqrt(jnp.where(rolls, -slope, 1.0) / drag), 0.0)
    speed = jnp.minimum(jnp.maximum(alone, slowest), desired_speed)
    for _ in range(NEWTON_STEPS):
        lacking = drag * speed**3 + slope * speed + auxiliary
        step = lacking / jnp.maximum(3.0 * drag * speed**2 + slope, 1e-6)
        speed = jnp.where(lacking > 0.0, jnp.maximum(speed - step, slowest), speed)
    return jnp.minimum(speed, desired_speed)


def apply_eco_speed(state: EnvState, config: EnvConfig, params: EnvParams) -> EnvState:
    """The state with desired speeds adapted to EVs' charge.

    Compliant drivers slow down once their charge is below `eco_soc` and does not last for `required_range`. Drivers of
    booked EVs do not, because their docking sets their speed.
    """
    vehicles, evs, drivers = state.vehicles, state.evs, params.drivers
    everyone = vehicles.desired_speed
    own, distance_m = everyone[config.ev_slots], required_range(vehicles, config, params)
    speed = lasting_speed(evs.energy_j, distance_m, own, drivers.eco_speed, params.ev, params.road)
    is_low = evs.energy_j < drivers.eco_soc * params.ev_capacity_j
    slows = evs.complies & is_low & (evs.med == NOT_BOOKED)
    desired = config.by_slot(
        everyone[config.med_slots], jnp.where(slows, speed, own), everyone[config.gas_slots]
    )
    return state.replace(vehicles=vehicles.replace(desired_speed=desired))
