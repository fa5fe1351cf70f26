"""How the coils of a docked pair stand to each other, how much they can send, and how much of it passes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.docking import is_docked, panel_lane, panel_x, partners
from medjax.numerics.gathers import read
from medjax.physics import input_resistance, interpolate_inductance, link_efficiency
from medjax.traffic.motion import turn_between
from medjax.world.params import FRONT, LEFT, RIGHT, EnvConfig, EnvParams, LinkParams, Scalar
from medjax.world.state import NOT_BOOKED, EVs, Vehicles


class Misalignment(NamedTuple):
    """Coil geometry of each pair, in the convention of `physics.mutual_inductance`."""

    axial: jax.Array  # m
    lateral: jax.Array  # m
    tilt: jax.Array  # rad


def misalignment(
    panel: jax.Array,
    along_m: jax.Array,
    across_m: jax.Array,
    turn_rad: jax.Array,
    panel_gap_m: jax.Array | float,
) -> Misalignment:
    """Geometry of a docked pair from how far the EV is off its slot.

    Side panels face across the road: their distance opens and closes as the vehicles wander, and
    what is lateral to the coils lies along the road. Front and rear panels face along it.

    Args:
      panel: int32, any shape.
      along_m: EV ahead of its slot, m.
      across_m: EV to the right of its slot, m.
      turn_rad: heading of the EV less that of the MED, positive to the right.
      panel_gap_m: nominal axial distance; booms give way, so it never falls below a quarter of it.
    """
    side = (panel == LEFT) | (panel == RIGHT)
    away = jnp.where(panel == RIGHT, 1.0, -1.0)
    outward = jnp.where(panel == FRONT, 1.0, -1.0)
    opening = jnp.where(side, away * across_m, outward * along_m)
    # Normals: the panel that faces right or back turns with the vehicle, its mirror image against it.
    tilt = jnp.where(side, away, -outward) * turn_rad
    return Misalignment(
        axial=jnp.maximum(panel_gap_m + opening, 0.25 * panel_gap_m),
        lateral=jnp.where(side, along_m, across_m),
        tilt=tilt,
    )


TINY = 1e-30  # H^2, nothing beside any inductance


class Coupled(NamedTuple):
    """What a pair of coils is to the one who feeds it."""

    efficiency: jax.Array  # in [0, 1]
    input_ohm: jax.Array  # RMS current squared times this is the power sent


def couple(
    geometry: Misalignment, link: LinkParams, form: Literal["circuit", "paper"] = "circuit"
) -> Coupled:
    """Each pair by the tabulated coil integral, and eq (6) in one of its forms."""
    signed = link.permeability * interpolate_inductance(
        link.inductance, geometry.axial, geometry.lateral, geometry.tilt
    )
    # Only its square counts. A root is what XLA does not work out once for each reader: without it, all would
    # interpolate anew, which takes a quarter of the tick. The smallest number keeps it from being an absolute value.
    inductance = jnp.sqrt(signed**2 + TINY)
    circuit = {
        "load": link.load_ohm,
        "primary_resistance": link.med_resistance_ohm,
        "secondary_resistance": link.ev_resistance_ohm,
        "angular_frequency": link.angular_frequency,
    }
    return Coupled(
        link_efficiency(inductance, form=form, **circuit), input_resistance(inductance, **circuit)
    )


Coupling = Callable[[Misalignment, LinkParams], Coupled]
"""Pairs of coils that stand so; of the shape of the geometry's fields."""

COUPLINGS: Mapping[str, Coupling] = {
    "circuit": couple,
    "paper": functools.partial(couple, form="paper"),  # eq (6) as it is printed
}


def most_power(coupled: Coupled, slot_power_w: Scalar, max_current_a: Scalar) -> jax.Array:
    """Power that a slot may send, W: its own, less where the MED's coil would need more than its current."""
    return jnp.minimum(slot_power_w, max_current_a**2 * coupled.input_ohm)


class Link(NamedTuple):
    """The coils of each EV with those of its MED, `(E,)` each."""

    is_charging: jax.Array  # bool
    efficiency: jax.Array  # in [0, 1], wherever they stand
    power_w: jax.Array  # that the MED may send


def links(
    vehicles: Vehicles,
    evs: EVs,
    length: jax.Array,
    config: EnvConfig,
    params: EnvParams,
    coupling: Coupling,
) -> Link:
    """Whether each EV charges, and how well its coils do where they stand.

    Args:
      length: (N,) m, of the vehicles.
    """
    ev_slots, med_slots = config.ev_slots, config.med_slots
    med = partners(vehicles, evs, length, config)
    goal = panel_x(evs.panel, med, length[ev_slots], params.charging.dock_gap_m)
    error = vehicles.x[ev_slots] - goal
    in_lane = vehicles.lane[ev_slots] == panel_lane(evs.panel, med.lane)
    med_offset, med_lateral_speed = read(
        (vehicles.lateral_offset[med_slots], vehicles.lateral_speed[med_slots]),
        jnp.maximum(evs.med, 0),
    )
    across = vehicles.lateral_offset[ev_slots] - med_offset
    turn = turn_between(
        med.speed, med_lateral_speed, vehicles.speed[ev_slots], vehicles.lateral_speed[ev_slots]
    )
    is_charging = (evs.med != NOT_BOOKED) & is_docked(
        error,
        vehicles.speed[ev_slots] - med.speed,
        in_lane & (jnp.abs(across) < 0.25 * params.road.lane_width_m),
        evs.is_charging,
        params.charging,
    )
    seen = params.link.misalignment_scale
    geometry = misalignment(
        evs.panel, seen * error, seen * across, seen * turn, params.link.panel_gap_m
    )
    coupled = coupling(geometry, params.link)
    power_w = most_power(coupled, params.charging.slot_power_w, params.link.max_current_a)
    return Link(is_charging, coupled.efficiency, power_w)
