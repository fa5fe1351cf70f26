"""Episode metrics, computed from the sums that a state carries."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.kinds import CLASSES, EVS, by_class
from medjax.world.state import EpisodeStats

JOULES_PER_KWH = 3.6e6
SECONDS_PER_HOUR = 3600.0


def episode_metrics(tally: EpisodeStats) -> dict[str, jax.Array]:
    """Metrics since reset, float32 scalars by name.

    Per EV that was on the road: depleted_share, mean_range_m (distance driven), and in kWh ev_driving_kwh, ev_saved_kwh
    (how much more the distance would take at desired speeds) and ev_received_kwh. mean_soc averages over EVs and time;
    exit_soc over EVs that finished their trip or ran out. A depleted EV counts as 0: in mean_soc until it is off the
    road, in exit_soc once. Delays, in vehicle-hours, are relative to each vehicle's desired speed; time spent waiting
    to enter is in queue_vehicle_s. energy_drawn_kwh is what MEDs use to drive plus what they send; system_efficiency is
    the share of it that reaches EV batteries; of the energy sent, if driving downhill gains MEDs energy on balance.
    """

    def ratio(numerator: jax.Array, denominator: jax.Array) -> jax.Array:
        there = denominator > 0.0
        return jnp.where(there, numerator / jnp.where(there, denominator, 1.0), 0.0)

    drawn_j = tally.med_driving_j + tally.energy_sent_j
    gross_j = jnp.maximum(tally.med_driving_j, 0.0) + tally.energy_sent_j
    evs, evs_left = (by_class(counts)[CLASSES.index(EVS)] for counts in (tally.entered, tally.left))
    return {
        "depleted_share": ratio(tally.depleted, evs),
        "mean_range_m": ratio(tally.ev_distance_m, evs),
        "mean_soc": ratio(tally.soc_seconds, tally.ev_seconds),
        "exit_soc": ratio(tally.exit_soc, evs_left + tally.depleted),
        "meds_dispatched": tally.meds_dispatched,
        "energy_delivered_kwh": tally.energy_received_j / JOULES_PER_KWH,
        "energy_lost_kwh": (tally.energy_sent_j - tally.energy_received_j) / JOULES_PER_KWH,
        "energy_sent_kwh": tally.energy_sent_j / JOULES_PER_KWH,
        "med_driving_kwh": tally.med_driving_j / JOULES_PER_KWH,
        "energy_drawn_kwh": drawn_j / JOULES_PER_KWH,
        "system_efficiency": ratio(tally.energy_received_j, gross_j),
        "ev_driving_kwh": ratio(tally.ev_driving_j / JOULES_PER_KWH, evs),
        "ev_saved_kwh": ratio((tally.ev_cruising_j - tally.ev_driving_j) / JOULES_PER_KWH, evs),
        "ev_received_kwh": ratio(tally.energy_received_j / JOULES_PER_KWH, evs),
        "ev_delay_h": tally.ev_delay_s / SECONDS_PER_HOUR,
        "gas_delay_h": tally.gas_delay_s / SECONDS_PER_HOUR,
        "med_hours": tally.med_seconds / SECONDS_PER_HOUR,
        "evs_entered": evs,
        "low_exits": tally.low_exits,
        "evs_depleted": tally.depleted,
        "evs_served": tally.evs_served,
        "ev_mean_speed": ratio(tally.ev_distance_m, tally.ev_seconds),
        "gas_mean_speed": ratio(tally.gas_distance_m.sum(), tally.gas_seconds.sum()),
        "queue_vehicle_s": tally.queue_seconds,
        "missed_exits": tally.missed_exits,
        "charging_stops": tally.charging_stops,
        "lane_changes": tally.lane_changes,
        "collisions": tally.collisions,
        "invalid_actions": tally.invalid_actions,
        "vehicle_ticks": tally.vehicle_ticks,
    }
