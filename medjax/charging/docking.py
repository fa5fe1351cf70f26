"""Docking: how a booked EV drives to its slot and stays there."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.stranded import coasting, to_the_right
from medjax.numerics.fusion import settled
from medjax.numerics.gathers import read
from medjax.traffic.following import Drivers, Platooning
from medjax.traffic.intents import ORDERED_DESIRE, Orders
from medjax.traffic.neighbours import NOBODY
from medjax.world.kinds import MED
from medjax.world.params import (
    CHARGING_SLOTS,
    FRONT,
    REAR,
    ChargingParams,
    DriverParams,
    EnvConfig,
    EnvParams,
)
from medjax.world.state import NOT_BOOKED, EnvState, EVs, Vehicles

# Lanes of the charging slots relative to the MED's lane: left, right, rear, front.
CHARGING_SLOT_LANE = (-1, 1, 0, 0)
# Before an EV crosses the MED's lane, it falls back to this distance behind the rear slot.
CROSSING_ROOM_M = 10.0
# An EV enters the MED's lane only within this distance of its slot. Otherwise other vehicles would fill the gap.
ENTRY_ROOM_M = 20.0
# Within this distance of its slot, for each lane to cross, an EV's lane change is urgent. Farther away, the EV
# overtakes like any other vehicle.
VIEW_M = 100.0
# Desire to change lanes at full urgency. Others then make room. The EV need not reach their speed first, since it never
# will.
PRESSING_DESIRE = 0.65


class Partner(NamedTuple):
    """The MED of each EV; all fields have the shape of the EVs."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    lane: jax.Array  # int32
    length: jax.Array  # m


def partners(vehicles: Vehicles, evs: EVs, length: jax.Array, config: EnvConfig) -> Partner:
    """The MED of each EV, `(E,)` fields; MED 0 for EVs that are not booked."""
    columns = Partner(vehicles.x, vehicles.speed, vehicles.lane, length)
    meds = jax.tree.map(lambda column: column[config.med_slots], columns)
    return read(meds, jnp.maximum(evs.med, 0))


def slots_on_road(med_lane: jax.Array, num_lanes: int) -> jax.Array:
    """Whether each slot of MEDs in these lanes, `(M,)`, lies on the road, `(M, 4)` bool."""
    lane = charging_slot_lane(jnp.arange(len(CHARGING_SLOTS), dtype=jnp.int32), med_lane[:, None])
    return (lane >= 0) & (lane < num_lanes)


def charging_slot_lane(charging_slot: jax.Array, med_lane: jax.Array) -> jax.Array:
    """Lane of a slot, int32; may be off the road."""
    return med_lane + jnp.asarray(CHARGING_SLOT_LANE, jnp.int32)[jnp.maximum(charging_slot, 0)]


def charging_slot_x(
    charging_slot: jax.Array, med: Partner, ev_length: jax.Array, dock_gap_m: jax.Array | float
) -> jax.Array:
    """Front-bumper position of an EV exactly in its slot, m; shapes broadcast."""
    beside = med.x - 0.5 * (med.length - ev_length)
    behind = med.x - med.length - dock_gap_m
    ahead = med.x + dock_gap_m + ev_length
    return jnp.where(
        charging_slot == REAR, behind, jnp.where(charging_slot == FRONT, ahead, beside)
    )


class Approach(NamedTuple):
    """Plan of a booked EV for a tick; all fields have the shape of the EVs."""

    goal_x: jax.Array  # m, target position
    desire: jax.Array  # to change to its next lane: -1 to 1, negative to go left, 0 for none
    is_near: jax.Array  # bool, so close to its goal that it makes no other lane changes
    leads: jax.Array  # bool, it drives ahead of its MED in the MED's lane


def plan_approach(
    x: jax.Array,
    lane: jax.Array,
    ev_length: jax.Array,
    charging_slot: jax.Array,
    med: Partner,
    params: ChargingParams,
) -> Approach:
    """Plans where each booked EV drives and which lane it takes next.

    An EV on the far side of the MED must cross the MED's lane, so it falls back behind the MED first. An EV enters the
    MED's lane only close to its slot. It enters ahead of the MED for the front slot, and behind it for all others.

    Args:
      x, lane, ev_length, charging_slot: of the EVs, equal shapes; charging_slot in 0..3.
      med: their MEDs, same shape.
    """
    wanted = charging_slot_lane(charging_slot, med.lane)
    crossing = (lane - med.lane) * (wanted - med.lane) < 0
    behind = charging_slot_x(jnp.full_like(charging_slot, REAR), med, ev_length, params.dock_gap_m)
    slot = charging_slot_x(charging_slot, med, ev_length, params.dock_gap_m)
    goal = jnp.where(crossing, behind - CROSSING_ROOM_M, slot)

    distance = jnp.abs(x - goal)
    direction = jnp.sign(wanted - lane)
    clear = jnp.where(charging_slot == FRONT, x - ev_length > med.x, x < med.x - med.length)
    is_near = distance < ENTRY_ROOM_M
    leads = (lane == med.lane) & (x > med.x)
    urgency = jnp.maximum(1.0 - distance / (VIEW_M * jnp.maximum(jnp.abs(wanted - lane), 1)), 0.0)
    urgency = jnp.where(leads, 1.0, urgency)
    urgency = jnp.where(lane + direction == med.lane, clear & is_near, urgency)
    return Approach(goal, PRESSING_DESIRE * urgency * direction, is_near, leads)


def approach_pace(
    ahead_m: jax.Array,
    med_speed: jax.Array,
    most_back: jax.Array,
    slowest: jax.Array | float,
    params: ChargingParams,
) -> jax.Array:
    """Speed at which an EV drives to its slot, m/s.

    It is the speed of the MED plus a bounded closing speed, which is proportional to the distance to go. The EV never
    drives slower than `slowest`, even if the MED does, because the EV itself may be what slows the MED. If the MED
    stays slow, the booking lapses.

    Args:
      ahead_m: m, position of the slot minus that of the EV.
      med_speed: m/s, same shape.
      most_back: m/s, highest speed of falling back, same shape.
      slowest: m/s, same shape or one for all.
    """
    closing_speed = jnp.clip(params.approach_rate * ahead_m, -most_back, params.approach_speed)
    return jnp.maximum(med_speed + closing_speed, slowest)


def room_ahead(
    x: jax.Array, ev_length: jax.Array, med: Partner, params: ChargingParams
) -> jax.Array:
    """How far an EV ahead of a MED in its lane may fall back before the MED has to brake for it, m."""
    return x - ev_length - med.x - params.platoon_min_gap - med.speed * params.platoon_headway


def gentle_rate(med_speed: jax.Array, drivers: DriverParams) -> jax.Array:
    """Share of `room_ahead` by which such an EV falls back in a second, 1/s.

    It is that of the closing speed that solves IDM's s* = gap, times three quarters, because an EV takes a second to
    reach its target speed.
    """
    comfort = jnp.sqrt(drivers.max_acceleration[MED] * drivers.comfortable_deceleration[MED])
    return 1.5 * comfort / jnp.maximum(med_speed, 1.0)


def docking_acceleration(
    speed: jax.Array, pace: jax.Array, comfortable_deceleration: jax.Array, params: ChargingParams
) -> jax.Array:
    """Acceleration towards the speed from `approach_pace`, m/s^2: the inner of two nested proportional control loops.

    With approach_rate k and speed_rate c, the characteristic equation of the position error is s^2 + c s + c k = 0. The
    caller takes the smaller of this acceleration and IDM's, so the EV comes no closer to any vehicle than IDM allows.

    To reach a slot, an EV never brakes harder than its comfortable deceleration. IDM followers are safe behind such a
    leader. They are not safe behind a leader that brakes as hard as it can.

    Args:
      speed, comfortable_deceleration: of the EVs, m/s and positive m/s^2; pace: m/s (`approach_pace`); equal shapes.

    Returns:
      m/s^2, same shape, at least -comfortable_deceleration.
    """
    return jnp.maximum(params.speed_rate * (pace - speed), -comfortable_deceleration)


def is_docked(
    error_m: jax.Array,
    relative_speed: jax.Array,
    in_lane: jax.Array,
    was_charging: jax.Array,
    params: ChargingParams,
) -> jax.Array:
    """Whether each EV is docked, bool.

    An EV docks within `dock_tolerance_m` and `dock_speed_tolerance`. It stays docked within the
    larger of `dock_tolerance_m` and `hold_tolerance_m`.
    """
    arrives = jnp.abs(error_m) <= params.dock_tolerance_m
    arrives &= jnp.abs(relative_speed) <= params.dock_speed_tolerance
    holds = was_charging & (jnp.abs(error_m) <= params.hold_tolerance_m)
    return in_lane & (arrives | holds)


def _pace(
    x: jax.Array,
    ev_length: jax.Array,
    charging_slot: jax.Array,
    med: Partner,
    service_speed: jax.Array,
    plan: Approach,
    params: EnvParams,
) -> jax.Array:
    """Speed of each booked EV on its way to its slot, `(E,)` m/s; `service_speed` is its MED's.

    An EV ahead of its MED in the MED's lane falls back slowly enough that the MED can keep its speed. Unless the EV has
    the front slot, it drives at least at the MED's service speed until it has left that lane.
    """
    charging = params.charging
    spare = jnp.maximum(room_ahead(x, ev_length, med, charging), 0.0)
    gently = gentle_rate(med.speed, params.drivers) * spare
    most_back = jnp.where(plan.leads, gently, charging.approach_speed)
    share = jnp.where(plan.leads & (charging_slot != FRONT), 1.0, charging.slowest_share)
    slowest = share * service_speed
    return approach_pace(plan.goal_x - x, med.speed, most_back, slowest, charging)


def approach(state: EnvState, drivers: Drivers, config: EnvConfig, params: EnvParams) -> Orders:
    """Orders that charging gives to traffic in a tick.

    MEDs change to their service lane and stay there while traffic in it moves. Booked EVs drive to their slots, in a
    platoon with their MED. Depleted EVs coast and head for the shoulder.
    """
    vehicles, evs, meds, slots = state.vehicles, state.evs, state.meds, config.ev_slots
    charging, booked = params.charging, evs.med != NOT_BOOKED
    med = partners(vehicles, evs, drivers.length, config)
    x, lane, length = vehicles.x[slots], vehicles.lane[slots], drivers.length[slots]
    plan = plan_approach(x, lane, length, evs.charging_slot, med, charging)
    service_speed = read(meds.service_speed, jnp.maximum(evs.med, 0))
    pace = _pace(x, length, evs.charging_slot, med, service_speed, plan, params)
    comfort = drivers.comfortable_deceleration[slots]
    docking = docking_acceleration(vehicles.speed[slots], pace, comfort, charging)
    # A MED drives around vehicles that stand in its lane, and then comes back.
    keeps = vehicles.speed[config.med_slots] > 0.5 * meds.service_speed
    to_service = jnp.sign(meds.service_lane - vehicles.lane[config.med_slots])
    ev_desire = jnp.where(evs.is_depleted, to_the_right(vehicles.speed[slots], params), 0.0)
    ev_desire = jnp.where(booked, plan.desire, ev_desire)
    desire = config.by_slot(ORDERED_DESIRE * to_service, ev_desire, 0.0)
    # Write into one array: on CPUs, XLA is slower at joining three arrays, as `by_slot` does.
    free = jnp.full((config.num_vehicles,), jnp.inf)
    most = jnp.where(evs.is_depleted, coasting(vehicles.speed[slots], params), jnp.inf)
    # Settled, since XLA for CPUs would compute it for all vehicles while it writes into their array.
    acceleration = settled(jnp.where(booked, docking, most), drivers.length >= 0.0)
    return Orders(
        platoon=config.by_slot(jnp.arange(config.num_meds, dtype=jnp.int32), evs.med, NOBODY),
        platooning=Platooning(charging.platoon_headway, charging.platoon_min_gap),
        acceleration=free.at[slots].set(acceleration),
        desire=desire,
        stay=config.by_slot(keeps, booked & plan.is_near | evs.is_depleted, False),
    )
