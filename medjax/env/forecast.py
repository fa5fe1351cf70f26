"""Who will need a MED soon: what the known demand and the charge of the EVs say."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.booking import can_serve, panel_flags
from medjax.charging.docking import slots_on_road
from medjax.charging.energy import cruising
from medjax.numerics.sums import in_units, rounded, sum_pairwise
from medjax.traffic.demand import entries, entry_rates
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, MERGING, NOT_BOOKED, QUEUED, EnvState


def med_places(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Where MEDs are, `(M,)` m: one that waits is at its ramp; inf for one that is not on its way."""
    ramp_x_m = params.road.ramp_x_m if config.num_ramps else jnp.zeros((1,), jnp.float32)
    vehicles, slots = state.vehicles, config.med_slots
    on_road = jnp.where(vehicles.active[slots], vehicles.x[slots], jnp.inf)
    return jnp.where(state.meds.status == QUEUED, ramp_x_m[state.meds.ramp], on_road)


def free_slots(state: EnvState, config: EnvConfig) -> jax.Array:
    """Slots on the road that no EV has booked, `(M,)` int32, of every MED where it serves, or is to serve."""
    evs, meds = state.evs, state.meds
    taken = panel_flags(evs.med, evs.panel, evs.med != NOT_BOOKED, config.num_meds)
    in_service = meds.status == IN_SERVICE
    lane = jnp.where(in_service, state.vehicles.lane[config.med_slots], meds.service_lane)
    return jnp.sum(slots_on_road(lane, config.num_lanes) & ~taken, axis=1, dtype=jnp.int32)


def lacking_j(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """What each EV lacks to come to its destination at cruising speed, `(E,)` J; negative where something is left."""
    cruise, power_w = cruising(params)
    x = state.vehicles.x[config.ev_slots]
    way = state.vehicles.destination[config.ev_slots] - x
    return way * (power_w / cruise) - state.evs.energy_j


class Need(NamedTuple):
    """What a MED from each ramp would find within a window, `(num_ramps,)` float32 each."""

    there: jax.Array  # EVs in need on the road
    shortfall: jax.Array  # what these lack to come to their destinations, packs
    coming: jax.Array  # EVs in need that the known demand brings, on average
    free: jax.Array  # free slots of MEDs that serve, or are about to, and are as near


def expected_need(
    state: EnvState, config: EnvConfig, params: EnvParams, window_s: float | jax.Array
) -> Need:
    """Who will need a MED from each ramp within the window, and who else has slots.

    In need are EVs that do not come to their destination on what they have at cruising speed: those without a booking
    on the way to the ramp that could catch up with the MED within the window, and those that the known demand brings
    in time, by the way to the end of the road.
    """
    road, demand = params.road, params.demand
    cruise, power_w = cruising(params)
    per_metre = power_w / cruise
    closing = jnp.maximum(cruise - params.fleet.service_speed, 1e-3)
    window_m = closing * window_s  # that an EV gains on a MED

    def ahead_of(x: jax.Array) -> jax.Array:
        """Way from places to the ramps, `(num_ramps, ...)` m."""
        return road.ramp_x_m[:, None] - x[None, :]

    x = state.vehicles.x[config.ev_slots]
    lacks_j = lacking_j(state, config, params)
    waits = (state.evs.med == NOT_BOOKED) & ~state.evs.is_depleted
    needy = state.vehicles.active[config.ev_slots] & (lacks_j > 0.0) & waits
    way = ahead_of(x)
    meets = needy & (way <= window_m) & (way >= -params.charging.reach_behind_m)
    lacks = jnp.where(meets, rounded(in_units(lacks_j, params.ev_capacity_j)), 0.0)

    where = entries(road, config.num_lanes)
    charge = (road.length_m - where.x) * per_metre / params.ev_capacity_j  # that the rest takes
    range_of_charge = jnp.maximum(demand.arrival_soc_high - demand.arrival_soc_low, 1e-6)
    share = jnp.clip((charge - demand.arrival_soc_low) / range_of_charge, 0.0, 1.0)
    rate = (
        entry_rates(demand, config.num_lanes, state.time * config.decision_s)
        * demand.ev_share
        * share
    )
    way = ahead_of(where.x)
    # Who enters behind the ramp must do so early enough to catch up.
    time = jnp.where(way >= 0.0, jnp.maximum(window_s - way / closing, 0.0), 0.0)

    meds = state.meds
    comes = (meds.status == QUEUED) | (meds.status == MERGING)
    serves = (comes | can_serve(meds, params)) & meds.accepts
    near = serves & (jnp.abs(ahead_of(med_places(state, config, params))) <= window_m)
    return Need(
        there=jnp.sum(meets, axis=1).astype(jnp.float32),
        shortfall=sum_pairwise(lacks),
        coming=sum_pairwise(rounded(rate * time)),
        free=jnp.sum(jnp.where(near, free_slots(state, config), 0), axis=1).astype(jnp.float32),
    )


def forecast_need(
    state: EnvState, config: EnvConfig, params: EnvParams, window_s: float
) -> jax.Array:
    """EVs in need of a MED from each ramp within the window, less free slots, `(num_ramps,)` float32."""
    need = expected_need(state, config, params, window_s)
    return need.there + need.coming - need.free
