"""Energy exchange of a tick: charging from MEDs to EVs, and driving."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.energy import drive_energy, per_metre
from medjax.charging.link import Link
from medjax.numerics.gathers import read
from medjax.numerics.sums import sum_pairwise
from medjax.physics import change_battery
from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams
from medjax.world.state import EnvState, EpisodeStats, EVs, MEDs, Vehicles


class Transfer(NamedTuple):
    """Energy of one tick, J."""

    sent_j: jax.Array  # (E,) out of the MED for each EV
    received_j: jax.Array  # (E,) into the EV's battery; the difference is lost
    drawn_j: jax.Array  # (M,) out of each MED; sums to the same total as sent_j


def transfer(
    efficiency: jax.Array,
    is_charging: jax.Array,
    med: jax.Array,
    med_available_j: jax.Array,
    room_j: jax.Array,
    offered_j: jax.Array,
) -> Transfer:
    """Energy of one tick. A slot sends what it may, or less if its MED runs short or its EV is nearly full.

    Args:
      efficiency: (E,); is_charging: (E,) bool; med: (E,) int32, NOT_BOOKED where free.
      med_available_j: (M,) J above the MED's reserve.
      room_j: (E,) J until the EV's battery is full.
      offered_j: (E,) J that the EV's slot may send in the tick.
    """
    arrives = jnp.minimum(offered_j * efficiency, jnp.maximum(room_j, 0.0))
    asked = jnp.where(is_charging, arrives / jnp.maximum(efficiency, 1e-6), 0.0)
    is_partner = med[:, None] == jnp.arange(med_available_j.shape[0], dtype=jnp.int32)
    wanted = jnp.sum(jnp.where(is_partner, asked[:, None], 0.0), axis=0)
    share = jnp.minimum(1.0, jnp.maximum(med_available_j, 0.0) / jnp.maximum(wanted, 1e-6))
    sent = asked * read(share, jnp.maximum(med, 0))
    return Transfer(sent, sent * efficiency, wanted * share)


def taper(energy_j: jax.Array, params: EnvParams) -> jax.Array:
    """Share of the offered power that EV batteries at this energy, `(E,)` J, accept.

    The share is 1 up to `taper_soc` and falls linearly to 0 at a full battery.

    Source: constant current, then constant voltage; see docs/models.md.
    """
    falls_over_j = params.ev_capacity_j * jnp.maximum(1.0 - params.charging.taper_soc, 1e-6)
    return jnp.clip((params.ev_capacity_j - energy_j) / falls_over_j, 0.0, 1.0)


def _driven(
    before: Vehicles,
    after: Vehicles,
    slots: slice,
    body: BodyParams,
    road: RoadParams,
    tick_s: float,
) -> jax.Array:
    """Driving energy of each battery in these slots, J; 0 off the road."""
    energy = drive_energy(before.speed[slots], after.speed[slots], body, road, tick_s)
    return jnp.where(before.active[slots], energy, 0.0)


def exchange(
    before: Vehicles,
    after: Vehicles,
    link: Link,
    state: EnvState,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[EVs, MEDs, EpisodeStats]:
    """Transfer and driving energy of one tick.

    The tally excludes braking energy that a full battery cannot take, and driving energy beyond what an EV's battery
    still holds. An empty MED drives on. The tally of driving includes that energy; what a depot gives back does not.

    Args:
      before, after: the vehicles before and after the tick.
      link: of each EV with its MED, after the tick.
      state: the batteries before the tick.

    Returns:
      The EVs and MEDs after the tick, and the tick's tally.
    """
    evs, meds, slots, tick_s = state.evs, state.meds, config.ev_slots, config.tick_s
    med_use = _driven(before, after, config.med_slots, params.med, params.road, tick_s)
    ev_use = _driven(before, after, slots, params.ev, params.road, tick_s)
    ev_use = jnp.where(evs.is_depleted, 0.0, ev_use)  # its motor is off
    flow = transfer(
        link.efficiency,
        link.is_charging,
        evs.med,
        meds.energy_j - params.fleet.reserve_soc * params.med_capacity_j,
        params.ev_capacity_j - (evs.energy_j - ev_use),
        link.power_w * taper(evs.energy_j, params) * tick_s,
    )
    ev_energy, ev_rest = change_battery(
        evs.energy_j, evs.rest_j, flow.received_j - ev_use, params.ev_capacity_j
    )
    med_energy, med_rest = change_battery(
        meds.energy_j, meds.rest_j, -med_use - flow.drawn_j, params.med_capacity_j
    )
    least, most = evs.energy_j - params.ev_capacity_j, evs.energy_j + flow.received_j
    med_room = params.med_capacity_j - (meds.energy_j - flow.drawn_j)
    # Energy to drive the same distance at each EV's desired speed.
    distance = after.x[slots] - before.x[slots]
    cruised = distance * per_metre(before.desired_speed[slots], params.ev, params.road)
    cruising_j = jnp.maximum(jnp.where(before.active[slots], cruised, 0.0), least)
    stats = EpisodeStats.zeros().replace(
        energy_sent_j=sum_pairwise(flow.sent_j),
        energy_received_j=sum_pairwise(flow.received_j),
        ev_driving_j=sum_pairwise(jnp.clip(ev_use, least, most)),
        ev_cruising_j=sum_pairwise(jnp.where(evs.is_depleted, 0.0, cruising_j)),
        med_driving_j=sum_pairwise(jnp.maximum(med_use, -med_room)),
        evs_served=jnp.sum(link.is_charging & ~evs.served, dtype=jnp.float32),
    )
    evs = evs.replace(
        energy_j=ev_energy,
        rest_j=ev_rest,
        is_charging=link.is_charging,
        served=evs.served | link.is_charging,
    )
    return evs, meds.replace(energy_j=med_energy, rest_j=med_rest), stats
