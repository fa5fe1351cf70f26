"""How all vehicles move in a tick: perception, car following, docking control, lane changes, motion."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.docking import Approach, Partner, docking_acceleration, plan_approach
from medjax.numerics.gathers import read
from medjax.traffic.following import (
    Drivers,
    Follower,
    Leader,
    Platooning,
    following_acceleration,
    gap_between,
    make_drivers,
    obstacle_acceleration,
    of_slots,
    roles,
)
from medjax.traffic.lane_change import Turn, Wish, decide, place_group, whose_turn
from medjax.traffic.motion import ballistic_step, lateral_step
from medjax.traffic.neighbours import NOBODY, Neighbours, find_neighbours, sort_by_road
from medjax.traffic.road import merge_distance
from medjax.world.params import AUTONOMOUS_EV, GAS, HUMAN_EV, MED, EnvConfig, EnvParams
from medjax.world.state import NOT_BOOKED, EnvState, EVs, Tally, Vehicles


def vehicle_kinds(is_human: jax.Array, config: EnvConfig) -> jax.Array:
    """Kind of each slot, `(..., N)` int32, by `is_human` `(..., E)`: its class by position, EVs by who drives."""
    lead = is_human.shape[:-1]
    return jnp.concatenate(
        [
            jnp.full((*lead, config.num_meds), MED, jnp.int32),
            jnp.where(is_human, HUMAN_EV, AUTONOMOUS_EV).astype(jnp.int32),
            jnp.full((*lead, config.num_gas), GAS, jnp.int32),
        ],
        axis=-1,
    )


def drivers_of(state: EnvState, config: EnvConfig, params: EnvParams) -> Drivers:
    """Drivers of all slots, `(N,)` each; they stay the same between two rounds of entries."""
    kind = vehicle_kinds(state.evs.is_human, config)
    return make_drivers(kind, state.vehicles.desired_speed, params.drivers)


def partners(vehicles: Vehicles, evs: EVs, length: jax.Array, config: EnvConfig) -> Partner:
    """The MED of each EV, `(E,)` fields; MED 0 stands in where an EV is not booked."""
    columns = Partner(vehicles.x, vehicles.speed, vehicles.lane, length)
    meds = jax.tree.map(lambda column: column[config.med_slots], columns)
    return read(meds, jnp.maximum(evs.med, 0))


def _platoons(state: EnvState, config: EnvConfig) -> jax.Array:
    """Index of the MED that each vehicle drives with, `(N,)` int32."""
    return jnp.concatenate(
        [
            jnp.arange(config.num_meds, dtype=jnp.int32),
            state.evs.med,
            jnp.full((config.num_gas,), NOBODY, jnp.int32),
        ]
    )


def _wishes(
    state: EnvState, approach: Approach, to_end: jax.Array, config: EnvConfig, params: EnvParams
) -> Wish:
    """Mandatory changes: off a ramp, a MED to its service lane, a booked EV to its slot's lane."""
    lane = state.vehicles.lane
    merging = lane == config.num_lanes
    booked = state.evs.med != NOT_BOOKED
    gas = jnp.zeros((config.num_gas,), jnp.int32)
    med_direction = jnp.sign(params.fleet.service_lane - lane[config.med_slots])
    ev_direction = jnp.where(booked, approach.direction, 0)
    direction = jnp.concatenate([med_direction, ev_direction, gas]).astype(jnp.int32)
    stay = jnp.concatenate([jnp.ones((config.num_meds,), bool), booked, gas.astype(bool)])
    return Wish(
        direction=jnp.where(merging, -1, direction),
        urgency=jnp.where(
            merging, jnp.clip(1.0 - to_end / params.road.acceleration_lane_m, 0.0, 1.0), 0.0
        ),
        stay=stay,
    )


def _approach(
    vehicles: Vehicles, evs: EVs, drivers: Drivers, config: EnvConfig, params: EnvParams
) -> tuple[Approach, jax.Array]:
    """Where booked EVs drive, and the acceleration that takes them there, inf for others."""
    med = partners(vehicles, evs, drivers.length, config)
    x, speed, lane, length, braking = (
        column[config.ev_slots]
        for column in (
            vehicles.x,
            vehicles.speed,
            vehicles.lane,
            drivers.length,
            drivers.comfortable_deceleration,
        )
    )
    approach = plan_approach(x, lane, length, evs.panel, med, params.charging)
    docking = docking_acceleration(x, speed, approach.goal_x, med.speed, braking, params.charging)
    return approach, jnp.where(evs.med != NOT_BOOKED, docking, jnp.inf)


def _lane_changes(
    state: EnvState,
    leaders: Leader,
    followers: Follower,
    neighbours: Neighbours,
    following: jax.Array,
    acceleration: jax.Array,
    wish: Wish,
    turn: Turn,
    platooning: Platooning,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """Lane steps of all vehicles in this tick, `(N,)` int32 in -1, 0, 1."""
    vehicles = state.vehicles
    changes = decide(
        leaders,
        followers,
        following,
        turn,
        neighbours,
        acceleration,
        wish,
        platooning,
        params.lane_change,
    )
    target = vehicles.lane + turn.direction
    settled = jnp.abs(vehicles.lateral_offset) < 0.5 * params.road.lane_width_m
    may_change = vehicles.active & settled & (target >= 0) & (target < config.num_lanes)
    return turn.direction * (may_change & place_group(changes, turn, config.num_vehicles))


def _step(
    vehicles: Vehicles, command: jax.Array, steps: jax.Array, config: EnvConfig, params: EnvParams
) -> Vehicles:
    """Motion of one tick under accelerations `(N,)` m/s2 and lane changes `(N,)` of -1, 0 or 1."""
    x, speed = ballistic_step(vehicles.x, vehicles.speed, command, config.tick_s)
    offset, lateral_speed = lateral_step(
        vehicles.lateral_offset - steps * params.road.lane_width_m,
        vehicles.lateral_speed,
        vehicles.wander,
        params.motion.lateral_rate,
        config.tick_s,
    )
    return vehicles.replace(
        x=jnp.where(vehicles.active, x, vehicles.x),
        speed=jnp.where(vehicles.active, speed, vehicles.speed),
        lane=vehicles.lane + steps,
        lateral_offset=offset,
        lateral_speed=lateral_speed,
    )


def move(
    state: EnvState, drivers: Drivers, tick: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[Vehicles, Tally]:
    """Moves all vehicles by one tick; who leaves the road is not yet taken off it.

    Args:
      state: of one environment.
      drivers: of its vehicles.
      tick: () int32; its parity says which way drivers look.
    """
    vehicles, evs, ev_slots = state.vehicles, state.evs, config.ev_slots
    leaders, followers = roles(drivers, vehicles.x, vehicles.speed, _platoons(state, config))
    turn = whose_turn(tick, config.lane_change_groups)
    with jax.named_scope("neighbours"):
        order = sort_by_road(vehicles.x, vehicles.active, params.road.length_m, vehicles.road_order)
        neighbours = find_neighbours(
            order,
            vehicles.lane,
            vehicles.lane + turn.direction,
            vehicles.active,
            config.num_lanes + 1,
        )

    with jax.named_scope("car_following"):
        leader, has_leader = of_slots(leaders, neighbours.leader), neighbours.leader != NOBODY
        platooning = Platooning(params.charging.platoon_headway, params.charging.platoon_min_gap)
        following = following_acceleration(followers, leader, has_leader, platooning)
        to_end = merge_distance(vehicles.x, params.road)
        wall = jnp.where(
            vehicles.lane == config.num_lanes, obstacle_acceleration(followers, to_end), jnp.inf
        )
        acceleration = jnp.minimum(following, wall)

    with jax.named_scope("docking"):
        approach, docking = _approach(vehicles, evs, drivers, config, params)
        command = acceleration.at[ev_slots].min(docking) + vehicles.acceleration_noise

    with jax.named_scope("lane_changes"):
        wish = _wishes(state, approach, to_end, config, params)
        steps = _lane_changes(
            state,
            leaders,
            followers,
            neighbours,
            following,
            acceleration,
            wish,
            turn,
            platooning,
            config,
            params,
        )

    with jax.named_scope("motion"):
        command = jnp.clip(command, -params.motion.max_braking, followers.max_acceleration)
        moved = _step(vehicles, command, steps, config, params).replace(road_order=order)
    overlapping = has_leader & (gap_between(followers, leader) < 0.0)
    tally = Tally.zeros().replace(
        lane_changes=jnp.sum(jnp.abs(steps), dtype=jnp.float32),
        collisions=jnp.sum(overlapping, dtype=jnp.float32),
    )
    return moved, tally
