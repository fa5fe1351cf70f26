"""Eco-driving: drivers of EVs slow down when their charge does not last for their trip."""

import jax
import jax.numpy as jnp

from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams, Scalar
from medjax.world.state import NOT_BOOKED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2, as `medjax.physics.tractive_energy`
# This many steps leave an error below 0.5 % of the speed. The error is largest where the charge hardly lasts at any
# speed, and 0 without auxiliary power.
NEWTON_STEPS = 6


def required_range(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Distance for which each EV's charge should last, `(E,)` m.

    It is the distance to the EV's exit. An EV that drives to the road's end has no exit, and its charge should last to
    that end and for at least `eco_horizon_m`. With an infinite `eco_horizon_m` no charge is enough, wherever EVs go.
    """
    horizon_m = params.drivers.eco_horizon_m
    destination = vehicles.destination[config.ev_slots]
    left = destination - vehicles.x[config.ev_slots]
    has_exit = (destination < params.road.length_m) & jnp.isfinite(horizon_m)
    return jnp.where(has_exit, left, jnp.maximum(left, horizon_m))


def lasting_speed(
    energy_j: jax.Array,
    distance_m: jax.Array,
    desired_speed: jax.Array,
    eco_speed: Scalar,
    body: BodyParams,
    road: RoadParams,
) -> jax.Array:
    """Highest speed, up to the desired one, at which the charge lasts; if it lasts at none, the most economical speed.

    By eq (7) and the drivetrain model, the energy per metre at a constant speed v is (c + k v^2) / eta + P / v, with
    resistance c, drag k v^2, drivetrain efficiency eta and auxiliary power P. Drivers slow down neither below
    `eco_speed` nor below the most economical speed, since slower driving would save no energy.

    Args:
      energy_j: (E,) J.
      distance_m: (E,) m; inf means that no charge is enough.
      desired_speed: (E,) m/s.
      eco_speed: m/s, lowest speed to which drivers slow down to save charge.

    Returns:
      (E,) m/s, at most desired_speed, and otherwise at least eco_speed.
    """
    drag = 0.5 * road.air_density * body.drag_coefficient * body.frontal_area_m2
    resistance = body.mass_kg * GRAVITY * (body.rolling_resistance + jnp.sin(road.slope))
    auxiliary = body.drivetrain_efficiency * body.auxiliary_w
    # The bound of 1e-12 keeps 0 out of the root, where its gradient is infinite.
    slowest = jnp.maximum(eco_speed, jnp.cbrt(jnp.maximum(auxiliary / (2.0 * drag), 1e-12)))
    # Solve k v^3 + (c - eta E / distance) v + eta P = 0 by Newton's method. The function is convex, so the steps
    # descend from their start, the solution without auxiliary power.
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
    """The state after drivers of EVs have adapted their desired speeds to their charge.

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
