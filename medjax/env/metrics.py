"""Episode metrics, computed from the sums that a state carries."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.kinds import CLASSES, EVS, by_class
from medjax.world.state import EpisodeStats

JOULES_PER_KWH = 3.6e6
SECONDS_PER_HOUR = 3600.0


def episode_metrics(stats: EpisodeStats) -> dict[str, jax.Array]:
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

    drawn_j = stats.med_driving_j + stats.energy_sent_j
    gross_j = jnp.maximum(stats.med_driving_j, 0.0) + stats.energy_sent_j
    evs, evs_left = (by_class(counts)[CLASSES.index(EVS)] for counts in (stats.entered, stats.left))
    return {
        "depleted_share": ratio(stats.depleted, evs),
        "mean_range_m": ratio(stats.ev_distance_m, evs),
        "mean_soc": ratio(stats.soc_seconds, stats.ev_seconds),
        "exit_soc": ratio(stats.exit_soc, evs_left + stats.depleted),
        "meds_dispatched": stats.meds_dispatched,
        "energy_delivered_kwh": stats.energy_received_j / JOULES_PER_KWH,
        "energy_lost_kwh": (stats.energy_sent_j - stats.energy_received_j) / JOULES_PER_KWH,
        "energy_sent_kwh": stats.energy_sent_j / JOULES_PER_KWH,
        "med_driving_kwh": stats.med_driving_j / JOULES_PER_KWH,
        "energy_drawn_kwh": drawn_j / JOULES_PER_KWH,
        "system_efficiency": ratio(stats.energy_received_j, gross_j),
        "ev_driving_kwh": ratio(stats.ev_driving_j / JOULES_PER_KWH, evs),
        "ev_saved_kwh": ratio((stats.ev_cruising_j - stats.ev_driving_j) / JOULES_PER_KWH, evs),
        "ev_received_kwh": ratio(stats.energy_received_j / JOULES_PER_KWH, evs),
        "ev_delay_h": stats.ev_delay_s / SECONDS_PER_HOUR,
        "gas_delay_h": stats.gas_delay_s / SECONDS_PER_HOUR,
        "med_hours": stats.med_seconds / SECONDS_PER_HOUR,
        "evs_entered": evs,
        "low_exits": stats.low_exits,
        "evs_depleted": stats.depleted,
        "evs_served": stats.evs_served,
        "ev_mean_speed": ratio(stats.ev_distance_m, stats.ev_seconds),
        "gas_mean_speed": ratio(stats.gas_distance_m.sum(), stats.gas_seconds.sum()),
        "queue_vehicle_s": stats.queue_seconds,
        "missed_exits": stats.missed_exits,
        "charging_stops": stats.charging_stops,
        "plug_stops": stats.plug_stops,
        "plug_wait_h": stats.plug_wait_s / SECONDS_PER_HOUR,
        "plug_charging_h": stats.plug_charging_s / SECONDS_PER_HOUR,
        "plug_kwh": stats.plug_energy_j / JOULES_PER_KWH,
        "lane_changes": stats.lane_changes,
        "collisions": stats.collisions,
        "invalid_actions": stats.invalid_actions,
        "vehicle_ticks": stats.vehicle_ticks,
    }
