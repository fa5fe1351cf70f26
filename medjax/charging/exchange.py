"""Energy from a MED's slots into EVs, through the coils."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.docking import Misalignment
from medjax.numerics.gathers import read
from medjax.physics import interpolate_inductance, link_efficiency
from medjax.world.params import LinkParams, Scalar


class Transfer(NamedTuple):
    """Energy of one tick, J."""

    sent_j: jax.Array  # (E,) to each EV out of its MED
    received_j: jax.Array  # (E,) into its battery; the difference is lost
    drawn_j: jax.Array  # (M,) out of each MED; adds up to sent_j


def coupling_efficiency(geometry: Misalignment, link: LinkParams) -> jax.Array:
    """Link efficiency of each pair, in [0, 1], by the tabulated coil integral and eq (6)."""
    inductance = interpolate_inductance(
        link.inductance, geometry.axial, geometry.lateral, geometry.tilt
    )
    return link_efficiency(
        inductance,
        load=link.load_ohm,
        primary_resistance=link.med_resistance_ohm,
        secondary_resistance=link.ev_resistance_ohm,
        angular_frequency=link.angular_frequency,
    )


def transfer(
    efficiency: jax.Array,
    is_charging: jax.Array,
    med: jax.Array,
    med_available_j: jax.Array,
    room_j: jax.Array,
    slot_energy_j: Scalar,
) -> Transfer:
    """What flows in one tick: slot power, less when the MED runs short or the EV is nearly full.

    Args:
      efficiency: (E,); is_charging: (E,) bool; med: (E,) int32, NOT_BOOKED where free.
      med_available_j: (M,) J above the MED's reserve.
      room_j: (E,) J until the EV's battery is full.
      slot_energy_j: J that a slot draws in a tick at full power.
    """
    fills = jnp.maximum(room_j, 0.0) / jnp.maximum(efficiency, 1e-6)
    asked = jnp.where(is_charging, jnp.minimum(slot_energy_j, fills), 0.0)
    is_partner = med[:, None] == jnp.arange(med_available_j.shape[0])
    wanted = jnp.sum(jnp.where(is_partner, asked[:, None], 0.0), axis=0)
    share = jnp.minimum(1.0, jnp.maximum(med_available_j, 0.0) / jnp.maximum(wanted, 1e-6))
    sent = asked * read(share, jnp.maximum(med, 0))
    return Transfer(sent, sent * efficiency, wanted * share)
