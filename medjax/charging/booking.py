"""Booking: EVs request slots, MEDs grant them, and bookings end. The map of EVs to slots is one-to-one.

Only the EVs store the map, in `med` and `charging_slot`. `charging_slot_flags` derives the MEDs' view from it.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.approach_time import LANE_CHANGE_S, approach_time, gentle_delay
from medjax.charging.docking import (
    Partner,
    charging_slot_lane,
    charging_slot_x,
    gentle_rate,
    plan_approach,
    slots_on_road,
)
from medjax.charging.energy import cruising
from medjax.errors import former_names
from medjax.numerics.gathers import read
from medjax.numerics.sums import count_down
from medjax.traffic.entry import Newcomers
from medjax.traffic.exits import distance_to_exit_preparation
from medjax.traffic.following import by_kind
from medjax.world.params import (
    CHARGING_SLOTS,
    FRONT,
    LEFT,
    REAR,
    RIGHT,
    ChargingParams,
    EnvConfig,
    EnvParams,
)
from medjax.world.state import IN_SERVICE, NOT_BOOKED, EnvState, EVs, MEDs, Vehicles

FAR = 1.0e9
__getattr__ = former_names(__name__, panel_flags="charging_slot_flags")

# An EV docks in time if the MED then still has at least this long to charge it.
WORTHWHILE_S = 10.0


def charging_slot_flags(
    med: jax.Array, charging_slot: jax.Array, flag: jax.Array, num_meds: int
) -> jax.Array:
    """Maps EVs' flags `(E,)`, such as booked or charging, to the MEDs' slots, `(num_meds, 4)`.

    A slot that no EV has booked gets False, or 0 if the flags are whole numbers. No two EVs book the same slot.
    """
    slots = num_meds * len(CHARGING_SLOTS)
    where = jnp.where(med != NOT_BOOKED, med * len(CHARGING_SLOTS) + charging_slot, slots)
    flags = jnp.zeros((slots,), flag.dtype).at[where].set(flag, mode="drop")
    return flags.reshape(num_meds, len(CHARGING_SLOTS))


def can_serve(meds: MEDs, params: EnvParams) -> jax.Array:
    """Whether each MED is in service with energy above its reserve, `(num_meds,)` bool."""
    reserve = params.fleet.reserve_soc * params.med_capacity_j
    return (meds.status == IN_SERVICE) & (meds.energy_j > reserve)


def unserved(energy_j: jax.Array, complies: jax.Array, sees_queues: jax.Array | None) -> EVs:
    """EVs that no MED has served, from their energy, `(E,)` J, and their drivers' traits, `(E,)` bool (see `EVs`)."""
    return EVs(
        energy_j=energy_j,
        rest_j=jnp.zeros_like(energy_j),
        med=jnp.full(energy_j.shape, NOT_BOOKED, jnp.int32),
        charging_slot=jnp.full(energy_j.shape, NOT_BOOKED, jnp.int32),
        stops=jnp.zeros(energy_j.shape, bool),
        is_charging=jnp.zeros(energy_j.shape, bool),
        waiting_s=jnp.zeros_like(energy_j),
        retry_in_s=jnp.zeros_like(energy_j),
        standing_s=jnp.zeros_like(energy_j),
        served=jnp.zeros(energy_j.shape, bool),
        complies=complies,
        sees_queues=sees_queues,
        is_depleted=jnp.zeros(energy_j.shape, bool),
    )


def init_new_evs(evs: EVs, newcomers: Newcomers, config: EnvConfig, params: EnvParams) -> EVs:
    """Writes newcomers into the EV slots that they took."""
    demand, entry = params.demand, newcomers.entry[config.ev_slots]
    span = demand.arrival_soc_high - demand.arrival_soc_low
    soc = demand.arrival_soc_low + newcomers.traits.charge * span
    complies = newcomers.traits.complies < params.drivers.eco_compliance
    sees = None
    if evs.sees_queues is not None:
        sees = newcomers.traits.sees_queues < params.charging.queue_seen_share
    soc, complies, sees = read((soc, complies, sees), jnp.maximum(entry, 0))
    fresh = unserved(soc * params.ev_capacity_j, complies, sees)
    return jax.tree.map(lambda new, old: jnp.where(entry >= 0, new, old), fresh, evs)


class Offers(NamedTuple):
    """What MEDs offer to EVs, `(M,)` each except `free` `(M, 4)` and `beside` `(M, 2)`."""

    x: jax.Array  # m
    speed: jax.Array  # m/s
    service_speed: jax.Array  # m/s
    gentle_rate: jax.Array  # 1/s, see `medjax.charging.docking.gentle_rate`
    lane: jax.Array  # int32
    length: jax.Array  # m
    free: jax.Array  # bool: the MED can serve and accepts EVs; the slot is on the road and free
    leaves_x: jax.Array  # m, where it leaves the road or starts to prepare for its exit
    beside: jax.Array  # (M, 2) bool: its left slot is booked, its right slot is booked


class Requests(NamedTuple):
    """What EVs request, `(E,)` each."""

    x: jax.Array  # m
    desired_speed: jax.Array  # m/s
    lane: jax.Array  # int32
    length: jax.Array  # m
    wants: jax.Array  # bool, requests a charging slot now
    endurance_s: jax.Array  # s, how long its energy lasts
    leaves_x: jax.Array  # m, as in `Offers`


def _first_minimum(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Minimum along the last axis, and its first index. On a CPU this takes a fifth of the time of argmin."""
    size = values.shape[-1]
    minimum = values.min(axis=-1)
    indices = jnp.where(values == minimum[..., None], jnp.arange(size, dtype=jnp.int32), size)
    return minimum, indices.min(axis=-1)


def _charging_slot_cost(requests: Requests, offer: Offers, params: ChargingParams) -> jax.Array:
    """Time for each EV to reach each slot of its nearest MED, `(E, 4)` s; FAR if it cannot reach the slot."""
    charging_slot = jnp.arange(len(CHARGING_SLOTS), dtype=jnp.int32)
    its_med = Partner(offer.x, offer.speed, offer.lane, offer.length)
    med = Partner(*(field[:, None] for field in its_med))
    x, lane, length = (field[:, None] for field in (requests.x, requests.lane, requests.length))
    slot = charging_slot_x(charging_slot, med, length, params.dock_gap_m)
    wanted = charging_slot_lane(charging_slot, med.lane)
    goal = plan_approach(x, lane, length, charging_slot, med, params).goal_x
    # An EV closes up at its desired speed and falls back at the slowest pace that docking gives it, either way at most
    # at the approach speed; ahead of the MED in its lane, as fast as the MED lets it. Who is no faster, or cannot be
    # slower, than the MED does not get there.
    faster = jnp.clip(requests.desired_speed - offer.speed, 0.0, params.approach_speed)[:, None]
    slower = jnp.maximum(offer.speed - params.slowest_share * offer.service_speed, 0.0)[:, None]
    in_lane = (charging_slot == FRONT) & (lane == med.lane) & (x > slot)
    slower = jnp.where(in_lane, slower, jnp.minimum(slower, params.approach_speed))
    up, down = jnp.maximum(goal - x, 0.0) + (slot - goal), jnp.maximum(x - goal, 0.0)
    closes = up > 0.0  # at last; whoever crosses the MED's lane falls back before
    seconds = jnp.where(closes, down / jnp.maximum(slower, 1e-3), 0.0)
    way, fastest = jnp.where(closes, up, down), jnp.where(closes, faster, slower)
    seconds += approach_time(way, fastest, params) + LANE_CHANGE_S * jnp.abs(wanted - lane)
    ev = requests.x, requests.lane, requests.length
    delay = gentle_delay(*ev, its_med, slower[:, FRONT], offer.gentle_rate, params)
    seconds += jnp.where(charging_slot == FRONT, delay[:, None], 0.0)
    # An EV cannot pass the MED in the MED's lane. Nor can it pass, in a side slot's lane, the EV that has booked that
    # slot. It would get stuck behind the other vehicle, or slow that vehicle down when it falls back.
    blocked = (lane == med.lane) & jnp.where(
        x < med.x, charging_slot == FRONT, charging_slot == REAR
    )
    abreast = charging_slot_x(jnp.full_like(charging_slot, LEFT), med, length, params.dock_gap_m)
    passes = (x < abreast) != (goal < abreast)
    on_left, on_right = offer.beside[:, :1], offer.beside[:, 1:]
    blocked |= passes & jnp.where(lane < med.lane, on_left, (lane > med.lane) & on_right)
    return jnp.where(offer.free & ~blocked, seconds, FAR)


def grant(
    med: jax.Array,
    charging_slot: jax.Array,
    requests: Requests,
    offers: Offers,
    params: ChargingParams,
) -> tuple[jax.Array, jax.Array]:
    """One round of booking: each EV asks its nearest MED, each MED takes its nearest EV.

    An EV asks only for a charging slot that it can reach in time: before the MED leaves the road or reaches the EV's
    own exit, before the EV's energy runs out, and before the booking would lapse. A MED takes the nearest of several
    EVs, and on a tie the one of the lowest index. The others ask again in the next round. As each MED takes one EV per
    round, the map is one-to-one by construction.

    Args:
      med, charging_slot: (E,) int32, each EV's booking so far; NOT_BOOKED without one.
      requests: the EVs' side.
      offers: the MEDs' side.

    Returns:
      (med, charging_slot) with the new bookings.
    """
    ahead = offers.x[None, :] - requests.x[:, None]
    within = (ahead <= params.reach_ahead_m) & (ahead >= -params.reach_behind_m)
    within &= offers.free.any(axis=-1)[None, :]
    distances = jnp.where(within, jnp.abs(ahead), FAR)
    distance, nearest = _first_minimum(distances)
    offer = Offers(*(field[nearest] for field in offers))

    cost = _charging_slot_cost(requests, offer, params)
    seconds, choice = _first_minimum(cost)
    leaves_x = jnp.minimum(offer.leaves_x, requests.leaves_x)
    time_left = (leaves_x - offer.x) / jnp.maximum(offer.speed, 1.0)
    in_time = (seconds + WORTHWHILE_S <= time_left) & (seconds < requests.endurance_s)
    in_time &= seconds <= params.patience_s  # or the booking would lapse before
    asks = requests.wants & (distance < FAR) & in_time

    num_meds = offers.x.shape[0]
    ev = jnp.arange(med.shape[0], dtype=jnp.int32)
    closest = jnp.full((num_meds,), FAR)
    closest = closest.at[jnp.where(asks, nearest, num_meds)].min(distance, mode="drop")
    first = asks & (distance == closest[nearest])
    taken = jnp.full((num_meds,), med.shape[0], jnp.int32)
    taken = taken.at[jnp.where(first, nearest, num_meds)].min(ev, mode="drop")
    accepted = first & (taken[nearest] == ev)
    return jnp.where(accepted, nearest, med), jnp.where(accepted, choice, charging_slot)


def requests_and_offers(
    state: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[Requests, Offers]:
    """What EVs request and MEDs offer in this round. An EV requests a charging slot below the SoC `request_soc`."""
    vehicles, evs, meds = state.vehicles, state.evs, state.meds
    med_slots, ev_slots = config.med_slots, config.ev_slots
    length = by_kind(vehicles.kind, params.drivers.vehicle_length)
    med_lane = vehicles.lane[med_slots]
    booked = charging_slot_flags(evs.med, evs.charging_slot, evs.med != NOT_BOOKED, config.num_meds)
    open_slots = slots_on_road(med_lane, config.num_lanes) & ~booked
    leaves_x = vehicles.destination
    if config.num_exits:
        to_exit = distance_to_exit_preparation(vehicles, config, params)
        leaves_x = jnp.minimum(leaves_x, vehicles.x + to_exit)
    offers = Offers(
        x=vehicles.x[med_slots],
        speed=vehicles.speed[med_slots],
        service_speed=meds.service_speed,
        gentle_rate=gentle_rate(vehicles.speed[med_slots], params.drivers),
        lane=med_lane,
        length=length[med_slots],
        free=(can_serve(meds, params) & meds.accepts)[:, None] & open_slots,
        leaves_x=leaves_x[med_slots],
        beside=booked[:, : RIGHT + 1],
    )
    lane = vehicles.lane[ev_slots]
    _, power_w = cruising(params)
    wants = vehicles.active[ev_slots] & (lane < config.num_lanes) & (evs.med == NOT_BOOKED)
    wants = wants & ~evs.is_depleted & (evs.retry_in_s <= 0.0)
    wants &= evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    requests = Requests(
        x=vehicles.x[ev_slots],
        desired_speed=vehicles.desired_speed[ev_slots],
        lane=lane,
        length=length[ev_slots],
        wants=wants,
        endurance_s=evs.energy_j / jnp.maximum(power_w, 1.0),  # downhill the power may be negative
        leaves_x=leaves_x[ev_slots],
    )
    return requests, offers


def book(state: EnvState, config: EnvConfig, params: EnvParams) -> EVs:
    """The EVs after one round of booking."""
    evs = state.evs
    requests, offers = requests_and_offers(state, config, params)
    med, charging_slot = grant(evs.med, evs.charging_slot, requests, offers, params.charging)
    return evs.replace(med=med, charging_slot=charging_slot)


def release(vehicles: Vehicles, evs: EVs, meds: MEDs, config: EnvConfig, params: EnvParams) -> EVs:
    """Ends a booking after a tick if the EV is charged, depleted, gone or late, or if its MED is gone or empty."""
    booked = evs.med != NOT_BOOKED
    partner = jnp.maximum(evs.med, 0)
    serves = can_serve(meds, params)
    waiting_s = jnp.where(booked & ~evs.is_charging, evs.waiting_s + config.tick_s, 0.0)
    late = waiting_s > params.charging.patience_s
    done = evs.energy_j >= params.charging.target_soc * params.ev_capacity_j
    lost = evs.is_depleted | ~vehicles.active[config.ev_slots]
    ends = booked & (late | done | lost | ~read(serves, partner))
    retry_in_s = count_down(evs.retry_in_s, config.tick_s)
    return evs.replace(
        med=jnp.where(ends, NOT_BOOKED, evs.med),
        charging_slot=jnp.where(ends, NOT_BOOKED, evs.charging_slot),
        is_charging=evs.is_charging & ~ends,
        waiting_s=jnp.where(ends, 0.0, waiting_s),
        retry_in_s=jnp.where(late, params.charging.retry_s, retry_in_s),
    )
