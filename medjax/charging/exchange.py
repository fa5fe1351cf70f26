"""Energy from a MED's slots into EVs, and from batteries into driving."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.energy import drive_energy
from medjax.charging.link import Link
from medjax.numerics.gathers import read
from medjax.numerics.sums import sum_pairwise
from medjax.physics import change_battery
from medjax.world.params import BodyParams, EnvConfig, EnvParams, Scalar
from medjax.world.state import EnvState, EVs, MEDs, Tally, Vehicles


class Transfer(NamedTuple):
    """Energy of one tick, J."""

    sent_j: jax.Array  # (E,) to each EV out of its MED
    received_j: jax.Array  # (E,) into its battery; the difference is lost
    drawn_j: jax.Array  # (M,) out of each MED; adds up to sent_j


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


def _driven(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, tick_s: float
) -> jax.Array:
    """Energy that driving takes from each battery in a tick, J; 0 off the road."""
    energy = drive_energy(before.speed[slots], after.speed[slots], body, tick_s)
    return jnp.where(before.active[slots], energy, 0.0)


def exchange(
    before: Vehicles,
    after: Vehicles,
    link: Link,
    state: EnvState,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[EVs, MEDs, Tally]:
    """Transfer and driving energy of one tick.

    Args:
      before, after: the vehicles around the tick.
      link: of each EV with its MED, after it.
      state: the batteries before it.

    Returns:
      (EVs, MEDs, what flowed)
    """
    evs, meds = state.evs, state.meds
    med_use = _driven(before, after, config.med_slots, params.med, config.tick_s)
    ev_use = _driven(before, after, config.ev_slots, params.ev, config.tick_s)
    ev_use = jnp.where(evs.is_depleted, 0.0, ev_use)  # its motor is off
    flow = transfer(
        link.efficiency,
        link.is_charging,
        evs.med,
        meds.energy_j - params.fleet.reserve_soc * params.med_capacity_j,
        params.ev_capacity_j - (evs.energy_j - ev_use),
        params.charging.slot_power_w * config.tick_s,
    )
    ev_energy, ev_rest = change_battery(
        evs.energy_j, evs.rest_j, flow.received_j - ev_use, params.ev_capacity_j
    )
    med_energy, med_rest = change_battery(
        meds.energy_j, meds.rest_j, -med_use - flow.drawn_j, params.med_capacity_j
    )
    tally = Tally.zeros().replace(
        energy_sent_j=sum_pairwise(flow.sent_j),
        energy_received_j=sum_pairwise(flow.received_j),
        evs_served=jnp.sum(link.is_charging & ~evs.served, dtype=jnp.float32),
    )
    evs = evs.replace(
        energy_j=ev_energy,
        rest_j=ev_rest,
        is_charging=link.is_charging,
        served=evs.served | link.is_charging,
    )
    return evs, meds.replace(energy_j=med_energy, rest_j=med_rest), tally
