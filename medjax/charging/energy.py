"""Battery energy that driving takes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.physics import battery_energy, tractive_energy
from medjax.world.kinds import AUTONOMOUS_EV
from medjax.world.params import BodyParams, EnvParams, RoadParams


def drive_energy(
    before: ArrayLike, after: ArrayLike, body: BodyParams, road: RoadParams, dt: float | jax.Array
) -> jax.Array:
    """Battery energy that vehicles take to drive for a time dt, J, by eqs (7)-(8) and the drivetrain model.

    Args:
      before, after: speeds, m/s, equal shapes.
      body: of the vehicles; road: slope and air; dt: s.
    """
    wheels = tractive_energy(
        before,
        after,
        dt,
        mass=body.mass_kg,
        drag_coefficient=body.drag_coefficient,
        frontal_area=body.frontal_area_m2,
        rolling_resistance=body.rolling_resistance,
        rotational_inertia_factor=body.rotational_inertia_factor,
        slope=road.slope,
        air_density=road.air_density,
    )
    return battery_energy(
        wheels,
        dt,
        drivetrain_efficiency=body.drivetrain_efficiency,
        regeneration_efficiency=body.regeneration_efficiency,
        auxiliary_power=body.auxiliary_w,
    )


def per_metre(speed: jax.Array, body: BodyParams, road: RoadParams) -> jax.Array:
    """Battery energy per metre at a constant speed, J; speeds in m/s, above 0."""
    return drive_energy(speed, speed, body, road, 1.0) / speed


def cruising(params: EnvParams) -> tuple[jax.Array, jax.Array]:
    """Desired speed of autonomous EVs, m/s, and the battery power that it takes, W."""
    speed = jnp.asarray(params.drivers.desired_speed[AUTONOMOUS_EV])
    return speed, drive_energy(speed, speed, params.ev, params.road, 1.0)
