"""How a booked EV gets to its slot and stays there."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.gathers import read
from medjax.traffic.following import Drivers, Platooning
from medjax.traffic.neighbours import NOBODY
from medjax.traffic.step import Orders
from medjax.world.params import FRONT, REAR, ChargingParams, EnvConfig, EnvParams
from medjax.world.state import NOT_BOOKED, EnvState, EVs, Vehicles

# Slot lanes relative to the MED's, by panel: left, right, rear, front.
PANEL_LANE = (-1, 1, 0, 0)
# An EV that must cross the MED's lane first keeps this much more than the dock gap behind it.
CROSSING_ROOM_M = 10.0
# A MED's own lane is entered only so near to the slot, or strangers would fill the space between.
ENTRY_ROOM_M = 20.0


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
    direction: jax.Array  # int32, side of a mandatory lane change, 0 none


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

    direction = jnp.sign(wanted - lane)
    enters_med_lane = lane + direction == med.lane
    clear = jnp.where(panel == FRONT, x - ev_length > med.x, x < med.x - med.length)
    near = jnp.abs(x - goal) < ENTRY_ROOM_M
    direction = jnp.where(enters_med_lane & ~(clear & near), 0, direction)
    return Approach(goal, direction)


def docking_acceleration(
    x: jax.Array,
    speed: jax.Array,
    goal_x: jax.Array,
    med_speed: jax.Array,
    comfortable_deceleration: jax.Array,
    params: ChargingParams,
) -> jax.Array:
    """Two nested proportional loops: distance asks for relative speed, that for acceleration.

    With approach_rate k and speed_rate c the error decays as s^2 + c s + c k = 0. The caller takes
    the smaller of this and IDM, so that no vehicle is approached closer than IDM allows.

    A slot is no emergency: for its sake nobody brakes harder than is comfortable, since IDM followers
    are safe behind a leader that brakes like that, and not behind one that brakes as hard as they can.

    Args:
      x, speed, comfortable_deceleration: of the EVs, m, m/s and positive m/s^2, one shape.
      goal_x: m, where to; med_speed: m/s, of their MEDs; that shape.

    Returns:
      m/s^2, that shape, at least -comfortable_deceleration.
    """
    closing = jnp.clip(
        params.approach_rate * (goal_x - x), -params.approach_speed, params.approach_speed
    )
    wanted = params.speed_rate * (med_speed + closing - speed)
    return jnp.maximum(wanted, -comfortable_deceleration)


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


def approach(state: EnvState, drivers: Drivers, config: EnvConfig, params: EnvParams) -> Orders:
    """What charging asks of traffic in a tick.

    MEDs change to their service lane and stay there; booked EVs drive to their slots, in one platoon with
    their MED.
    """
    vehicles, evs, slots = state.vehicles, state.evs, config.ev_slots
    booked = evs.med != NOT_BOOKED
    med = partners(vehicles, evs, drivers.length, config)
    x, lane = vehicles.x[slots], vehicles.lane[slots]
    plan = plan_approach(x, lane, drivers.length[slots], evs.panel, med, params.charging)
    docking = docking_acceleration(
        x,
        vehicles.speed[slots],
        plan.goal_x,
        med.speed,
        drivers.comfortable_deceleration[slots],
        params.charging,
    )
    to_service = jnp.sign(params.fleet.service_lane - vehicles.lane[config.med_slots])
    direction = config.by_slot(to_service, jnp.where(booked, plan.direction, 0), 0)
    # A write into one array, where `by_slot` would join three: XLA for CPUs is slower at that.
    free = jnp.full((config.num_vehicles,), jnp.inf)
    return Orders(
        platoon=config.by_slot(jnp.arange(config.num_meds, dtype=jnp.int32), evs.med, NOBODY),
        platooning=Platooning(params.charging.platoon_headway, params.charging.platoon_min_gap),
        acceleration=free.at[slots].set(jnp.where(booked, docking, jnp.inf)),
        direction=direction.astype(jnp.int32),
        stay=config.by_slot(True, booked, False),
    )
