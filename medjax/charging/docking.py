"""How a booked EV gets to its slot and stays there."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.charging.stranded import coasting, to_the_right
from medjax.numerics.gathers import read
from medjax.traffic.following import Drivers, Platooning
from medjax.traffic.neighbours import NOBODY
from medjax.traffic.wishes import ORDERED_DESIRE, Orders
from medjax.world.kinds import MED
from medjax.world.params import FRONT, PANELS, REAR, ChargingParams, EnvConfig, EnvParams
from medjax.world.state import NOT_BOOKED, EnvState, EVs, Vehicles

# Slot lanes relative to the MED's, by panel: left, right, rear, front.
PANEL_LANE = (-1, 1, 0, 0)
# An EV that must cross the MED's lane first keeps this much more than the dock gap behind it.
CROSSING_ROOM_M = 10.0
# A MED's own lane is entered only so near to the slot, or strangers would fill the space between.
ENTRY_ROOM_M = 20.0
# From so far on, a lane to cross, a change becomes urgent; until then the EV overtakes as anyone does.
VIEW_M = 100.0
# How urgent it is at last: others make room, and it need not be as fast as they are, since it will not be.
PRESSING_DESIRE = 0.65


class Partner(NamedTuple):
    """The MED of each EV; every field has the shape of the EVs."""

    x: jax.Array  # m, front bumper
    speed: jax.Array  # m/s
    lane: jax.Array  # int32
    length: jax.Array  # m


def partners(vehicles: Vehicles, evs: EVs, length: jax.Array, config: EnvConfig) -> Partner:
    """The MED of each EV, `(E,)` fields; MED 0 stands in where an EV is not booked."""
    columns = Partner(vehicles.x, vehicles.speed, vehicles.lane, length)
    meds = jax.tree.map(lambda column: column[config.med_slots], columns)
    return read(meds, jnp.maximum(evs.med, 0))


def slots_on_road(med_lane: jax.Array, num_lanes: int) -> jax.Array:
    """Whether a slot of MEDs in these lanes, `(M,)`, lies in a lane of the road, `(M, 4)` bool."""
    lane = panel_lane(jnp.arange(len(PANELS), dtype=jnp.int32), med_lane[:, None])
    return (lane >= 0) & (lane < num_lanes)


def panel_lane(panel: jax.Array, med_lane: jax.Array) -> jax.Array:
    """Lane of a slot, int32; may lie off the road."""
    return med_lane + jnp.asarray(PANEL_LANE, jnp.int32)[jnp.maximum(panel, 0)]


def panel_x(
    panel: jax.Array, med: Partner, ev_length: jax.Array, dock_gap_m: jax.Array | float
) -> jax.Array:
    """Front-bumper position of an EV that stands exactly in its slot, m; shapes broadcast."""
    beside = med.x - 0.5 * (med.length - ev_length)
    behind = med.x - med.length - dock_gap_m
    ahead = med.x + dock_gap_m + ev_length
    return jnp.where(panel == REAR, behind, jnp.where(panel == FRONT, ahead, beside))


class Approach(NamedTuple):
    """What a booked EV does in a tick, each of the shape of the EVs."""

    goal_x: jax.Array  # m, where it controls to
    desire: (
        jax.Array
    )  # of a change to the lane that it must take next: -1 to 1, left where negative, 0 none
    is_near: jax.Array  # bool, so near to its goal that it changes lanes for nothing else
    leads: jax.Array  # bool, it drives ahead of its MED in the MED's lane


def plan_approach(
    x: jax.Array,
    lane: jax.Array,
    ev_length: jax.Array,
    panel: jax.Array,
    med: Partner,
    params: ChargingParams,
) -> Approach:
    """Where to drive and which lane to take next.

    An EV on the far side of the MED falls back behind it first, since its way leads through the
    MED's lane. The MED's lane is entered only close to the slot, and on the right side of the MED.

    Args:
      x, lane, ev_length, panel: of the EVs, one shape; panel in 0..3.
      med: its MED, that shape.
    """
    wanted = panel_lane(panel, med.lane)
    crossing = (lane - med.lane) * (wanted - med.lane) < 0
    behind = panel_x(jnp.full_like(panel, REAR), med, ev_length, params.dock_gap_m)
    slot = panel_x(panel, med, ev_length, params.dock_gap_m)
    goal = jnp.where(crossing, behind - CROSSING_ROOM_M, slot)

    way = jnp.abs(x - goal)
    direction = jnp.sign(wanted - lane)
    clear = jnp.where(panel == FRONT, x - ev_length > med.x, x < med.x - med.length)
    is_near = way < ENTRY_ROOM_M
    leads = (lane == med.lane) & (x > med.x)
    urgency = jnp.maximum(1.0 - way / (VIEW_M * jnp.maximum(jnp.abs(wanted - lane), 1)), 0.0)
    urgency = jnp.where(leads, 1.0, urgency)
    urgency = jnp.where(lane + direction == med.lane, clear & is_near, urgency)
    return Approach(goal, PRESSING_DESIRE * urgency * direction, is_near, leads)


def platooning_of(params: ChargingParams) -> Platooning:
    """How close a MED and the EVs booked on it drive."""
    return Platooning(params.platoon_headway, params.platoon_min_gap)


def unhurried(
    gap: jax.Array, speed: jax.Array, platooning: Platooning, comfort: jax.Array | float
) -> jax.Array:
    """How much faster than its leader a MED may be at this gap without slowing down, m/s: IDM's s* = gap, solved.

    Three quarters of it, since the leader, an EV, takes a second to come to the speed that it wants.

    Args:
      gap: m, to its leader, which is of its platoon; speed: m/s, its own; one shape.
      comfort: m/s^2, root of its acceleration times its comfortable deceleration.
    """
    spare = gap - platooning.min_gap - speed * platooning.time_headway
    return 1.5 * comfort * jnp.maximum(spare, 0.0) / jnp.maximum(speed, 1.0)


def approach_pace(
    ahead_m: jax.Array,
    med_speed: jax.Array,
    most_back: jax.Array,
    slowest: jax.Array | float,
    params: ChargingParams,
) -> jax.Array:
    """Speed at which an EV drives to its slot, m/s: the MED's and a share of the way to go, within bounds.

    It falls back on the move, since what makes its MED slow may be the EV itself: never slower than `slowest`,
    however slow the MED is. Traffic goes by; if the MED does not get faster, the booking lapses.

    Args:
      ahead_m: m, the slot less the EV; med_speed: m/s; most_back: m/s, at which it may fall back; one shape.
      slowest: m/s, that shape or one for all.
    """
    closing = jnp.clip(params.approach_rate * ahead_m, -most_back, params.approach_speed)
    return jnp.maximum(med_speed + closing, slowest)


def docking_acceleration(
    speed: jax.Array,
    pace: jax.Array,
    comfortable_deceleration: jax.Array,
    params: ChargingParams,
) -> jax.Array:
    """To that pace, m/s^2: the inner one of two nested proportional loops.

    With approach_rate k and speed_rate c the error of place decays as s^2 + c s + c k = 0. The caller takes
    the smaller of this and IDM, so that no vehicle is approached closer than IDM allows.

    A slot is no emergency: for its sake nobody brakes harder than is comfortable, since IDM followers
    are safe behind a leader that brakes like that, and not behind one that brakes as hard as they can.

    Args:
      speed, comfortable_deceleration: of the EVs, m/s and positive m/s^2; pace: m/s (`approach_pace`); one shape.

    Returns:
      m/s^2, that shape, at least -comfortable_deceleration.
    """
    return jnp.maximum(params.speed_rate * (pace - speed), -comfortable_deceleration)


def is_docked(
    error_m: jax.Array,
    relative_speed: jax.Array,
    in_lane: jax.Array,
    was_charging: jax.Array,
    params: ChargingParams,
) -> jax.Array:
    """Whether a slot's coil runs: docked within the tight tolerance, kept within the wide one."""
    arrives = jnp.abs(error_m) <= params.dock_tolerance_m
    arrives &= jnp.abs(relative_speed) <= params.dock_speed_tolerance
    holds = was_charging & (jnp.abs(error_m) <= params.hold_tolerance_m)
    return in_lane & (arrives | holds)


def _pace(
    x: jax.Array,
    ev_length: jax.Array,
    panel: jax.Array,
    med: Partner,
    service_speed: jax.Array,
    plan: Approach,
    params: EnvParams,
) -> jax.Array:
    """Speed of each booked EV on its way to its slot, `(E,)` m/s, `service_speed` being that of its MED.

    Ahead of its MED in the MED's lane it falls back no faster than lets the MED keep its speed; and if it has no
    business there, it drives as fast as the MED means to until it has left that lane.
    """
    charging, drivers = params.charging, params.drivers
    comfort = jnp.sqrt(drivers.max_acceleration[MED] * drivers.comfortable_deceleration[MED])
    gently = unhurried(x - ev_length - med.x, med.speed, platooning_of(charging), comfort)
    most_back = jnp.where(plan.leads, gently, charging.approach_speed)
    share = jnp.where(plan.leads & (panel != FRONT), 1.0, charging.slowest_share)
    slowest = share * service_speed
    return approach_pace(plan.goal_x - x, med.speed, most_back, slowest, charging)


def approach(state: EnvState, drivers: Drivers, config: EnvConfig, params: EnvParams) -> Orders:
    """What charging asks of traffic in a tick.

    MEDs change to their service lane and stay there while it moves; booked EVs drive to their slots, in one
    platoon with their MED; depleted ones coast and make for the shoulder.
    """
    vehicles, evs, slots = state.vehicles, state.evs, config.ev_slots
    booked = evs.med != NOT_BOOKED
    med = partners(vehicles, evs, drivers.length, config)
    x, lane = vehicles.x[slots], vehicles.lane[slots]
    plan = plan_approach(x, lane, drivers.length[slots], evs.panel, med, params.charging)
    service_speed = read(state.meds.service_speed, jnp.maximum(evs.med, 0))
    pace = _pace(x, drivers.length[slots], evs.panel, med, service_speed, plan, params)
    docking = docking_acceleration(
        vehicles.speed[slots], pace, drivers.comfortable_deceleration[slots], params.charging
    )
    # A MED goes round who stands in its lane, and comes back.
    keeps = vehicles.speed[config.med_slots] > 0.5 * state.meds.service_speed
    to_service = jnp.sign(state.meds.service_lane - vehicles.lane[config.med_slots])
    ev_desire = jnp.where(evs.is_depleted, to_the_right(vehicles.speed[slots], params), 0.0)
    ev_desire = jnp.where(booked, plan.desire, ev_desire)
    desire = config.by_slot(ORDERED_DESIRE * to_service, ev_desire, 0.0)
    # A write into one array, where `by_slot` would join three: XLA for CPUs is slower at that.
    free = jnp.full((config.num_vehicles,), jnp.inf)
    most = jnp.where(evs.is_depleted, coasting(vehicles.speed[slots], params), jnp.inf)
    return Orders(
        platoon=config.by_slot(jnp.arange(config.num_meds, dtype=jnp.int32), evs.med, NOBODY),
        platooning=platooning_of(params.charging),
        acceleration=free.at[slots].set(jnp.where(booked, docking, most)),
        desire=desire,
        stay=config.by_slot(keeps, booked & plan.is_near | evs.is_depleted, False),
    )
