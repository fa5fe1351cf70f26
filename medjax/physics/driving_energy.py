"""Energy of a vehicle's motion, at the wheels and from its battery."""

import jax.numpy as jnp

from medjax.numerics.shapes import Arrays, Floats, Numbers
from medjax.physics._arrays import as_floats


def tractive_energy(
    speed_before: Numbers,
    speed_after: Numbers,
    dt: Numbers,
    *,
    mass: Numbers,
    drag_coefficient: Numbers,
    frontal_area: Numbers,
    rolling_resistance: Numbers,
    rotational_inertia_factor: Numbers = 1.0,
    slope: Numbers = 0.0,
    air_density: Numbers = 1.2,
    gravity: Numbers = 9.81,
) -> Floats:
    """Energy at the wheels over one time step, by one term of the paper's eqs (7)-(8).

    It is the force of rolling resistance (as in eq (7) without the cosine of the slope), air drag at the mean speed,
    inertia and slope, times the distance driven. All arguments broadcast to the shape of the result, `(...)`.

    Args:
      speed_before: speed at the start of the step (V_{i-1}), m/s, not negative.
      speed_after: speed at its end (V_i), m/s, not negative.
      dt: length of the step (t_inc), s, positive.
      mass: m, kg.
      drag_coefficient: C_D, dimensionless.
      frontal_area: A_F, m^2.
      rolling_resistance: C_RR, dimensionless.
      rotational_inertia_factor: r, the factor by which rotating parts raise the inertia, dimensionless.
      slope: angle of the road, rad, positive uphill.
      air_density: rho, kg/m^3.
      gravity: g, m/s^2.

    Returns:
      Energy in J, negative when braking or rolling downhill yields more than resistance takes.
      It is in the widest floating type among the arguments.
    """
    vehicle = mass, drag_coefficient, frontal_area, rolling_resistance, rotational_inertia_factor
    before, after, dt, mass, drag, area, rolling, inertia, slope, density, gravity = as_floats(
        speed_before, speed_after, dt, *vehicle, slope, air_density, gravity
    )
    mean_speed = (before + after) / 2
    force = (
        mass * gravity * (rolling + jnp.sin(slope))
        + density * drag * area * mean_speed**2 / 2
        + mass * inertia * (after - before) / dt
    )
    return force * mean_speed * dt


def battery_energy(
    tractive_energy: Numbers,
    dt: Numbers,
    *,
    drivetrain_efficiency: Numbers = 1.0,
    regeneration_efficiency: Numbers = 1.0,
    auxiliary_power: Numbers = 0.0,
) -> Floats:
    """Energy that one time step takes out of the battery.

    Driving energy is divided by the drivetrain's efficiency, braking energy multiplied by the regeneration's. The
    defaults give eq (8) of the paper, without losses. All arguments broadcast to the shape of the result, `(...)`.

    Args:
      tractive_energy: energy at the wheels in the step, J, negative when braking.
      dt: length of the step, s.
      drivetrain_efficiency: share of battery energy that reaches the wheels, in (0, 1].
      regeneration_efficiency: share of braking energy that reaches the battery, in [0, 1]; 0 for friction brakes only.
      auxiliary_power: power of other loads (climate, electronics), W.

    Returns:
      Energy in J, negative when the battery is charged, in the widest floating type among the arguments. The caller
      applies the battery's limits (full, empty, power).
    """
    wheels, dt, drivetrain, regeneration, auxiliary = as_floats(
        tractive_energy, dt, drivetrain_efficiency, regeneration_efficiency, auxiliary_power
    )
    through_motor = jnp.where(wheels >= 0, wheels / drivetrain, wheels * regeneration)
    return through_motor + auxiliary * dt


def change_battery(
    energy: Arrays, rest: Arrays, change: Numbers, capacity: Numbers
) -> tuple[Floats, Floats]:
    """Battery energy after a change, within 0 and capacity, by a compensated sum.

    In float32 the energy of a truck's 400 kWh pack is a multiple of 128 J. Rounding at every time step would lose small
    loads, so the rounding error is carried to the next step.

    Args:
      energy: J, in [0, capacity]; all arguments broadcast, any shape.
      rest: J, as the step before returned it; 0 at first.
      change: J, positive into the battery.
      capacity: J.

    Returns:
      (energy, rest), J, which add up to the exact sum; rest is 0 if the energy was clipped at 0 or at capacity.

    Source: Kahan 1965, Further remarks on reducing truncation errors.
    """
    change = jnp.add(change, rest)
    total = energy + change
    kept = jnp.clip(total, 0.0, capacity)
    return kept, jnp.where(kept == total, change - (total - energy), 0.0)
