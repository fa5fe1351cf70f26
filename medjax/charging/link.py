"""The coil link of a docked pair: misalignment, power and efficiency."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.docking import charging_slot_lane, charging_slot_x, is_docked, partners
from medjax.errors import former_names
from medjax.numerics.gathers import read
from medjax.physics import input_resistance, interpolate_inductance, link_efficiency
from medjax.traffic.motion import heading_difference
from medjax.world.params import FRONT, LEFT, RIGHT, EnvConfig, EnvParams, LinkParams, Scalar
from medjax.world.state import NOT_BOOKED, EVs, Vehicles

__getattr__ = former_names(__name__, most_power="max_power")


class Misalignment(NamedTuple):
    """Coil geometry of each pair, in the convention of `physics.mutual_inductance`."""

    axial: jax.Array  # m
    lateral: jax.Array  # m
    tilt: jax.Array  # rad


def misalignment(
    charging_slot: jax.Array,
    along_m: jax.Array,
    across_m: jax.Array,
    turn_rad: jax.Array,
    panel_gap_m: jax.Array | float,
) -> Misalignment:
    """Coil geometry of a docked pair from the EV's displacement off its slot.

    Side panels face across the road, front and rear panels along it.

    Args:
      charging_slot: int32, any shape.
      along_m, across_m: how far the EV is ahead of its slot, and to the right of it, m.
      turn_rad: heading of the EV minus that of the MED, positive to the right.
      panel_gap_m: nominal axial distance, m. The booms that hold the panels give way, so the distance never falls
        below a quarter of it.
    """
    side = (charging_slot == LEFT) | (charging_slot == RIGHT)
    away = jnp.where(charging_slot == RIGHT, 1.0, -1.0)
    outward = jnp.where(charging_slot == FRONT, 1.0, -1.0)
    opening = jnp.where(side, away * across_m, outward * along_m)
    # Tilt has the sign of the turn for panels that face right or back, the opposite sign for left and front.
    tilt = jnp.where(side, away, -outward) * turn_rad
    axial = jnp.maximum(panel_gap_m + opening, 0.25 * panel_gap_m)
    return Misalignment(axial, jnp.where(side, along_m, across_m), tilt)


TINY = 1e-30  # H^2, negligible beside any inductance squared


class Coupled(NamedTuple):
    """Electrical properties of a coil pair, seen from its source."""

    efficiency: jax.Array  # in [0, 1]
    input_ohm: jax.Array  # power sent, divided by the square of the RMS current


def couple(
    geometry: Misalignment, link: LinkParams, form: Literal["circuit", "paper"] = "circuit"
) -> Coupled:
    """Computes each pair's efficiency and input resistance from the tabulated coil integral and a form of eq (6)."""
    signed = link.permeability * interpolate_inductance(
        link.inductance, geometry.axial, geometry.lateral, geometry.tilt
    )
    # The root of the square keeps XLA from interpolating anew for each use, which would take a quarter of the tick: XLA
    # does not recompute a root. The lost sign does not matter, because only the square does. TINY keeps XLA from
    # simplifying the root to an absolute value.
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
"""A function from coil geometry to `Coupled`, in which fields have the shape of the geometry's fields."""

COUPLINGS: Mapping[str, Coupling] = {
    "circuit": couple,
    "paper": functools.partial(couple, form="paper"),  # eq (6) as printed
}


def max_power(coupled: Coupled, slot_power_w: Scalar, max_current_a: Scalar) -> jax.Array:
    """Power that a slot may send, W: its rated power, or less where the MED's coil reaches its maximum current."""
    return jnp.minimum(slot_power_w, max_current_a**2 * coupled.input_ohm)


class Link(NamedTuple):
    """The coil link of each EV with its MED, `(E,)` each."""

    is_charging: jax.Array  # bool
    efficiency: jax.Array  # in [0, 1], docked or not
    power_w: jax.Array  # W, that the MED may send


def links(
    vehicles: Vehicles,
    evs: EVs,
    length: jax.Array,
    config: EnvConfig,
    params: EnvParams,
    coupling: Coupling,
) -> Link:
    """Whether each EV charges, and the efficiency and power of its link.

    Args:
      length: (N,) m, of the vehicles.
    """
    slots, med_slots, charging = config.ev_slots, config.med_slots, params.charging
    speed, offset, lateral_speed = vehicles.speed, vehicles.lateral_offset, vehicles.lateral_speed
    med = partners(vehicles, evs, length, config)
    goal = charging_slot_x(evs.charging_slot, med, length[slots], charging.dock_gap_m)
    error = vehicles.x[slots] - goal
    in_lane = vehicles.lane[slots] == charging_slot_lane(evs.charging_slot, med.lane)
    med_offset, med_lateral_speed = read(
        (offset[med_slots], lateral_speed[med_slots]), jnp.maximum(evs.med, 0)
    )
    across = offset[slots] - med_offset
    turn = heading_difference(med.speed, med_lateral_speed, speed[slots], lateral_speed[slots])
    in_lane &= jnp.abs(across) < 0.25 * params.road.lane_width_m
    is_charging = (evs.med != NOT_BOOKED) & is_docked(
        error, speed[slots] - med.speed, in_lane, evs.is_charging, charging
    )
    seen = params.link.misalignment_scale
    geometry = misalignment(
        evs.charging_slot, seen * error, seen * across, seen * turn, params.link.panel_gap_m
    )
    coupled = coupling(geometry, params.link)
    power_w = max_power(coupled, charging.slot_power_w, params.link.max_current_a)
    return Link(is_charging, coupled.efficiency, power_w)
