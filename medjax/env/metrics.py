"""The figures of an episode, from the sums that a state carries."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.kinds import CLASSES, EVS, by_class
from medjax.world.state import Tally

JOULES_PER_KWH = 3.6e6


def episode_metrics(tally: Tally) -> dict[str, jax.Array]:
    """Metrics since reset, float32 scalars by name.

    depleted_share is of all EVs that were on the road; mean_range_m is the distance that such an EV
    drove on it; mean_soc averages over EVs and time; exit_soc averages over the EVs that ended their
    way. One without energy counts 0 in both: in mean_soc until it is off the road, in exit_soc once.
    """

    def ratio(numerator: jax.Array, denominator: jax.Array) -> jax.Array:
        return numerator / jnp.maximum(denominator, 1.0)

    evs, evs_left = (by_class(counts)[CLASSES.index(EVS)] for counts in (tally.entered, tally.left))
    return {
        "depleted_share": ratio(tally.depleted, evs),
        "mean_range_m": ratio(tally.ev_distance_m, evs),
        "mean_soc": ratio(tally.soc_seconds, tally.ev_seconds),
        "exit_soc": ratio(tally.exit_soc, evs_left + tally.depleted),
        "meds_dispatched": tally.meds_dispatched,
        "energy_delivered_kwh": tally.energy_received_j / JOULES_PER_KWH,
        "energy_lost_kwh": (tally.energy_sent_j - tally.energy_received_j) / JOULES_PER_KWH,
        "evs_entered": evs,
        "evs_depleted": tally.depleted,
        "evs_served": tally.evs_served,
        "ev_mean_speed": ratio(tally.ev_distance_m, tally.ev_seconds),
        "gas_mean_speed": ratio(tally.gas_distance_m.sum(), tally.gas_seconds.sum()),
        "queue_vehicle_s": tally.queue_seconds,
        "lane_changes": tally.lane_changes,
        "collisions": tally.collisions,
        "invalid_actions": tally.invalid_actions,
        "vehicle_ticks": tally.vehicle_ticks,
    }
