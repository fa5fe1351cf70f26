"""Whether an EV's charge lasts for its way, and what its driver does where it does not: drive slower."""

import jax
import jax.numpy as jnp

from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams, Scalar
from medjax.world.state import NOT_BOOKED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2, as `medjax.physics.tractive_energy`
# They leave less than 0.5 % of the speed, most where hardly any speed lasts; nothing where there are no auxiliaries.
NEWTON_STEPS = 6


def way_to_go(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Way that each EV's driver wants the charge to last for, `(E,)` m: to its exit, or beyond the road's end.

    Who drives to the end of the road goes on beyond it, for `eco_horizon_m` from here.
    """
    destination = vehicles.destination[config.ev_slots]
    left = destination - vehicles.x[config.ev_slots]
    beyond = jnp.maximum(left, params.drivers.eco_horizon_m)
    return jnp.where(destination < params.road.length_m, left, beyond)


def lasting_speed(
    energy_j: jax.Array,
    way_m: jax.Array,
    desired_speed: jax.Array,
    eco_speed: Scalar,
    body: BodyParams,
    road: RoadParams,
) -> jax.Array:
    """The fastest speed, up to the desired one, at which the charge lasts; as slow as helps where none does.

    What a metre takes at a constant speed v, (c + k v^2) / eta + P / v by eq (7) and the drivetrain, falls with the
    speed down to where auxiliaries outweigh drag. There, or at `eco_speed` before, slowing down ends.

    Args:
      energy_j, way_m, desired_speed: (E,) J, m (inf: no charge is enough), m/s.
      eco_speed: m/s, slower than which nobody drives to save charge.

    Returns:
      (E,) m/s, at most desired_speed, and not below eco_speed where that is.
    """
    drag = 0.5 * road.air_density * body.drag_coefficient * body.frontal_area_m2
    resistance = body.mass_kg * GRAVITY * (body.rolling_resistance + jnp.sin(road.slope))
    auxiliary = body.drivetrain_efficiency * body.auxiliary_w
    # Not the root of 0, where its gradient has no end.
    slowest = jnp.maximum(eco_speed, jnp.cbrt(jnp.maximum(auxiliary / (2.0 * drag), 1e-12)))
    # k v^3 + (c - eta E / way) v + eta P = 0, by Newton's method: it is convex, and one comes down from where the
    # charge would last without auxiliaries.
    slope = resistance - body.drivetrain_efficiency * energy_j / jnp.maximum(way_m, 1.0)
    rolls = slope < 0.0  # else 0 is under the root, whose gradient has no end there
    alone = jnp.where(rolls, jnp.sqrt(jnp.where(rolls, -slope, 1.0) / drag), 0.0)
    speed = jnp.minimum(jnp.maximum(alone, slowest), desired_speed)
    for _ in range(NEWTON_STEPS):
        lacking = drag * speed**3 + slope * speed + auxiliary
        step = lacking / jnp.maximum(3.0 * drag * speed**2 + slope, 1e-6)
        speed = jnp.where(lacking > 0.0, jnp.maximum(speed - step, slowest), speed)
    return jnp.minimum(speed, desired_speed)


def answering(state: EnvState, config: EnvConfig, params: EnvParams) -> EnvState:
    """The state with the desired speeds that EVs' drivers have in view of their charge.

    Those who comply slow down once they have less than `eco_soc` and it does not last for `way_to_go`. A booked EV
    has help in sight, and drives as its docking wants.
    """
    vehicles, evs, slots = state.vehicles, state.evs, config.ev_slots
    drivers, own = params.drivers, vehicles.desired_speed[slots]
    speed = lasting_speed(
        evs.energy_j,
        way_to_go(vehicles, config, params),
        own,
        drivers.eco_speed,
        params.ev,
        params.road,
    )
    is_low = evs.energy_j < drivers.eco_soc * params.ev_capacity_j
    slows = evs.complies & is_low & (evs.med == NOT_BOOKED)
    everyone = vehicles.desired_speed
    desired = config.by_slot(
        everyone[config.med_slots], jnp.where(slows, speed, own), everyone[config.gas_slots]
    )
    return state.replace(vehicles=vehicles.replace(desired_speed=desired))
