"""Forecast of EVs that will need a MED soon, from their charge and the demand that is known or that detectors show."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.booking import can_serve, charging_slot_flags
from medjax.charging.docking import slots_on_road
from medjax.charging.energy import cruising
from medjax.numerics.sums import block_fma, scale_by, sum_pairwise
from medjax.traffic.demand import entries, entry_rates
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, MERGING, NOT_BOOKED, QUEUED, EnvState


def med_positions(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Position of each MED, `(M,)` m: a queued MED is at its ramp; inf if neither queued nor on the road."""
    ramp_x_m = params.road.ramp_x_m if config.num_ramps else jnp.zeros((1,), jnp.float32)
    vehicles, slots = state.vehicles, config.med_slots
    on_road = jnp.where(vehicles.active[slots], vehicles.x[slots], jnp.inf)
    return jnp.where(state.meds.status == QUEUED, ramp_x_m[state.meds.ramp], on_road)


def free_slots(state: EnvState, config: EnvConfig) -> jax.Array:
    """Unbooked slots of each MED, `(M,)` int32, in its present lane if in service, else in its service lane."""
    evs, meds = state.evs, state.meds
    taken = charging_slot_flags(evs.med, evs.charging_slot, evs.med != NOT_BOOKED, config.num_meds)
    in_service = meds.status == IN_SERVICE
    lane = jnp.where(in_service, state.vehicles.lane[config.med_slots], meds.service_lane)
    return jnp.sum(slots_on_road(lane, config.num_lanes) & ~taken, axis=1, dtype=jnp.int32)


def lacking_j(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Energy that each EV lacks to reach its destination with `wanted_soc`, `(E,)` J; negative means a surplus.

    It drives at cruising speed.
    """
    cruise, power_w = cruising(params)
    x = state.vehicles.x[config.ev_slots]
    distance = state.vehicles.destination[config.ev_slots] - x
    wanted_j = params.charging.wanted_soc * params.ev_capacity_j
    return distance * (power_w / cruise) - state.evs.energy_j + wanted_j


class Need(NamedTuple):
    """Need and supply that a MED from each ramp would meet within a window, `(num_ramps,)` float32 each."""

    there: jax.Array  # EVs in need on the road
    shortfall: jax.Array  # energy these lack to their destinations, EV battery capacities
    coming: jax.Array  # expected EVs in need among future arrivals
    free: jax.Array  # free slots of MEDs nearby that serve or soon will


def expected_need(
    state: EnvState, config: EnvConfig, params: EnvParams, window_s: float | jax.Array
) -> Need:
    """EVs that will need a MED from each ramp within the window, and slots that other MEDs offer.

    An EV is in need if its charge does not last to its destination (`lacking_j`). Counted are unbooked EVs that can
    catch up within the window with a MED that leaves now, and expected arrivals, bound for the road's end, that can do
    so with a MED that leaves as they enter. These are more than can catch up with a MED that leaves now, by the ratio
    of the EVs' speed to what it exceeds the MED's by. Rules that read the number weigh it.
    """
    road, demand, meds = params.road, params.demand, state.meds
    cruise, power_w = cruising(params)
    per_metre = power_w / cruise
    closing_speed = jnp.maximum(cruise - params.fleet.service_speed, 1e-3)
    window_m = closing_speed * window_s  # distance that an EV gains on a MED

    def ahead_of(x: jax.Array) -> jax.Array:
        """Distance from positions to the ramps, `(num_ramps, ...)` m."""
        return road.ramp_x_m[:, None] - x[None, :]

    x = state.vehicles.x[config.ev_slots]
    lacks_j = lacking_j(state, config, params)
    waits = (state.evs.med == NOT_BOOKED) & ~state.evs.is_depleted
    needy = state.vehicles.active[config.ev_slots] & (lacks_j > 0.0) & waits
    distance = ahead_of(x)
    meets = needy & (distance <= window_m) & (distance >= -params.charging.reach_behind_m)
    lacks = jnp.where(meets, block_fma(scale_by(lacks_j, params.ev_capacity_j)), 0.0)

    where = entries(road, config.num_lanes)
    # What an EV bound for the end of the road needs on entry.
    charge = (road.length_m - where.x) * per_metre / params.ev_capacity_j
    charge += params.charging.wanted_soc
    range_of_charge = jnp.maximum(demand.arrival_soc_high - demand.arrival_soc_low, 1e-6)
    share = jnp.clip((charge - demand.arrival_soc_low) / range_of_charge, 0.0, 1.0)
    rate = state.detected_per_s
    if rate is None:
        rate = entry_rates(demand, config.num_lanes, state.time * config.decision_s)
    rate = rate * demand.ev_share * share
    distance = ahead_of(where.x)
    # An EV that enters upstream of the ramp still has that way to make up.
    time = jnp.where(distance >= 0.0, jnp.maximum(window_s - distance / closing_speed, 0.0), 0.0)

    comes = (meds.status == QUEUED) | (meds.status == MERGING)
    serves = (comes | can_serve(meds, params)) & meds.accepts
    # EVs are counted as far as this past a ramp, so MEDs are, too.
    near_m = jnp.maximum(window_m, params.charging.reach_behind_m)
    near = serves & (jnp.abs(ahead_of(med_positions(state, config, params))) <= near_m)
    return Need(
        there=jnp.sum(meets, axis=1).astype(jnp.float32),
        shortfall=sum_pairwise(lacks),
        coming=sum_pairwise(block_fma(rate * time)),
        free=jnp.sum(jnp.where(near, free_slots(state, config), 0), axis=1).astype(jnp.float32),
    )


def num_detectors(config: EnvConfig) -> int:
    """Number of detectors that are observed: one at each entry, or none."""
    return config.num_entries if config.has_detectors else 0


def detected_flows(state: EnvState) -> jax.Array:
    """What the detectors show, `(num_detectors,)` thousand vehicles/h."""
    per_s = state.detected_per_s
    return jnp.zeros((0,), jnp.float32) if per_s is None else 3.6 * per_s


def forecast_need(
    state: EnvState, config: EnvConfig, params: EnvParams, window_s: float
) -> jax.Array:
    """EVs that will need a MED from each ramp within the window, minus free slots, `(num_ramps,)` float32."""
    need = expected_need(state, config, params, window_s)
    return need.there + need.coming - need.free
