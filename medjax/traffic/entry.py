"""Entering the road: arrivals join queues and enter when there is a safe gap."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.numerics.fusion import settled
from medjax.numerics.gathers import read
from medjax.traffic.arrivals import Traits, draw_round, draw_traits
from medjax.traffic.demand import (
    Entries,
    assign_slots,
    desired_speeds,
    drawn_kinds,
    entries,
    entry_rates,
    poisson_arrivals,
    surge_factors,
)
from medjax.traffic.entry_gap import entry_speed, next_ahead, would_cut_off
from medjax.traffic.exits import draw_destinations, next_exit
from medjax.traffic.following import by_kind
from medjax.traffic.road import NO_LANE, straddled_lane
from medjax.traffic.safety import BrakingLimits
from medjax.world.kinds import MED
from medjax.world.params import DemandParams, EnvConfig, EnvParams
from medjax.world.state import MERGING, QUEUED, EnvState, EpisodeStats, Vehicles, count_kinds


def _waiting_meds(state: EnvState, config: EnvConfig) -> tuple[jax.Array, jax.Array]:
    """The first MED waiting at each entry, `(K,)` int32, and whether there is one."""
    ramp = jnp.arange(config.num_ramps, dtype=jnp.int32)
    waits = (state.meds.status == QUEUED) & (state.meds.ramp == ramp[:, None])
    none = jnp.zeros((config.num_lanes,), jnp.int32)
    first = jnp.concatenate([none, jnp.argmax(waits, axis=1).astype(jnp.int32)])
    return first, jnp.concatenate([none.astype(bool), waits.any(axis=1)])


class Newcomers(NamedTuple):
    """Vehicles that entered the road in a round of entries."""

    entry: jax.Array  # (N,) int32, the entry whose vehicle a slot received, -1 for none
    traits: Traits  # (K,) each, of the vehicle at each entry, meaningful if it entered


class _NextUp(NamedTuple):
    """The next vehicle at each entry, `(K,)` each."""

    kind: jax.Array  # int32
    is_ev: jax.Array  # bool, of the first in the queue
    desired_speed: jax.Array  # m/s
    time_headway: jax.Array  # s
    destination: jax.Array  # m


def _next_up(traits: Traits, where: Entries, med_waits: jax.Array, params: EnvParams) -> _NextUp:
    """The next vehicle at each entry: a waiting MED, else the first in the queue."""
    is_ev = traits.is_ev < params.demand.ev_share
    kind = drawn_kinds(traits.kind, is_ev, params.demand.class_shares)
    kind = jnp.where(med_waits, MED, kind)
    drivers, road = params.drivers, params.road
    desired = desired_speeds(traits.speed, kind, drivers)
    own = draw_destinations(traits.destination, where.x, params.demand, road)
    far = where.x + jnp.maximum(params.fleet.trip_m, road.exit_notice_m)
    destination = jnp.where(med_waits, next_exit(far, road), own)
    return _NextUp(kind, is_ev, desired, by_kind(kind, drivers.time_headway), destination)


def _safe_speed(
    next_up: _NextUp, where: Entries, state: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[jax.Array, jax.Array]:
    """Entry speed of each and whether it may enter, `(K,)` each."""
    vehicles, drivers = state.vehicles, params.drivers
    length = by_kind(vehicles.kind, drivers.vehicle_length)
    width = by_kind(vehicles.kind, drivers.vehicle_width)
    other = straddled_lane(vehicles.lane, vehicles.lateral_offset, width, params.road.lane_width_m)
    max_acceleration = by_kind(vehicles.kind, drivers.max_acceleration)
    # Settled, since XLA for CPUs would compute them anew for each entry.
    other, length, max_acceleration = settled((other, length, max_acceleration), width >= 0.0)
    at = vehicles.x, vehicles.lane, other, length, vehicles.speed, vehicles.active
    ahead = next_ahead(where, *at)
    desired, kind = next_up.desired_speed, next_up.kind
    on_ramp = where.lane == config.num_lanes
    wanted = jnp.where(on_ramp, jnp.minimum(desired, params.demand.ramp_speed), desired)
    min_gap, braking = by_kind(kind, drivers.min_gap), params.motion.max_braking
    speed, safe = entry_speed(wanted, ahead, next_up.time_headway, min_gap, braking)
    other = jnp.where(vehicles.active, other, NO_LANE)
    own_length = by_kind(kind, drivers.vehicle_length)
    limits = BrakingLimits(braking, config.tick_s)
    cuts = would_cut_off(
        where, own_length, vehicles.x, other, vehicles.speed, max_acceleration, limits
    )
    return speed, safe & ~cuts


def _put_on_road(
    vehicles: Vehicles, entry: jax.Array, next_up: _NextUp, where: Entries, speed: jax.Array
) -> Vehicles:
    """Writes newcomers into their slots: `entry` `(N,)` as in `Newcomers`, entry speeds `(K,)` m/s."""
    new, source = entry >= 0, jnp.maximum(entry, 0)
    of_entry = {
        "x": where.x,
        "speed": speed,
        "lane": where.lane,
        "kind": next_up.kind,
        "desired_speed": next_up.desired_speed,
        "headway": next_up.time_headway,
        "destination": next_up.destination,
    }
    calm = ("lateral_offset", "lateral_speed", "acceleration_noise", "wander", "recovery_s")
    values: dict[str, ArrayLike] = {
        **read(of_entry, source),
        **dict.fromkeys(calm, 0.0),
        **dict.fromkeys(("courtesy_left", "courtesy_right"), jnp.inf),
    }
    entered = {
        name: jnp.where(new, value, getattr(vehicles, name)) for name, value in values.items()
    }
    return vehicles.replace(active=vehicles.active | new, **entered)


def _smoothed(
    detected_per_s: jax.Array | None, placed: jax.Array, config: EnvConfig, demand: DemandParams
) -> jax.Array | None:
    """The detectors' smoothed counts, `(K,)` vehicles/s, after a round in which the entries `placed` `(K,)` let one in.

    Exponential smoothing: each count weighs less with a time constant of `detector_s`.
    """
    if detected_per_s is None:
        return None
    weight = -jnp.expm1(-config.round_s / demand.detector_s)
    return detected_per_s + weight * (placed / config.round_s - detected_per_s)


def admit(
    state: EnvState, number: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, Newcomers, EpisodeStats]:
    """One round of entries: at most one vehicle per entry, MEDs first.

    An arrival without a safe gap or a free slot of its class waits in the queue. The caller initialises the
    newcomers' `EVs` data.

    Args:
      number: () int32, rounds since the episode's start.

    Returns:
      (state, newcomers, tally of entries and queues)
    """
    demand, active, num_entries = params.demand, state.vehicles.active, config.num_entries
    time_s = number * config.round_s
    rates = entry_rates(demand, config.num_lanes, time_s)
    if (surges := state.surges) is not None:
        rates *= surge_factors(surges, config, demand, time_s)
    expected = rates * config.round_s
    arrived = poisson_arrivals(draw_round(state.arrivals, num_entries, number), expected)
    queue = state.queue + arrived

    first_med, med_waits = _waiting_meds(state, config)
    where = entries(params.road, config.num_lanes)
    # A MED keeps its traits whichever ramp it enters by.
    stream = jnp.where(med_waits, num_entries, jnp.arange(num_entries, dtype=jnp.int32))
    traits = draw_traits(
        state.arrivals, stream, jnp.where(med_waits, first_med, state.entered_here)
    )
    next_up = _next_up(traits, where, med_waits, params)
    speed, safe = _safe_speed(next_up, where, state, config, params)

    ordinary = safe & ~med_waits & (queue > 0)
    ev_entry, ev_placed = assign_slots(ordinary & next_up.is_ev, ~active[config.ev_slots])
    gas_entry, gas_placed = assign_slots(ordinary & ~next_up.is_ev, ~active[config.gas_slots])
    enters = jnp.where(med_waits & safe, first_med, config.num_meds)
    med_entry = jnp.full((config.num_meds,), -1, jnp.int32)
    med_entry = med_entry.at[enters].set(jnp.arange(num_entries, dtype=jnp.int32), mode="drop")
    entry = config.by_slot(med_entry, ev_entry, gas_entry)
    vehicles = _put_on_road(state.vehicles, entry, next_up, where, speed)
    status = jnp.where(med_entry >= 0, MERGING, state.meds.status)

    placed = ev_placed | gas_placed
    queue = queue - placed
    queued_meds = jnp.sum(status == QUEUED, dtype=jnp.int32)
    stats = EpisodeStats.zeros().replace(
        entered=count_kinds(entry >= 0, vehicles.kind, config),
        queue_seconds=(jnp.sum(queue, dtype=jnp.int32) + queued_meds).astype(jnp.float32)
        * config.round_s,
    )
    state = state.replace(
        vehicles=vehicles,
        meds=state.meds.replace(status=status),
        queue=queue,
        detected_per_s=_smoothed(state.detected_per_s, placed, config, demand),
        entered_here=state.entered_here + placed,
    )
    return state, Newcomers(entry, traits), stats
