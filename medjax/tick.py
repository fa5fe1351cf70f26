"""One physics tick: everyone looks, accelerates, changes lanes, moves, and energy flows."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.docking import (
    Approach,
    Partner,
    docking_acceleration,
    is_docked,
    misalignment,
    panel_x,
    plan_approach,
)
from medjax.charging.transfer import coupling_efficiency, transfer
from medjax.config import AUTONOMOUS_EV, GAS, HUMAN_EV, MED, BodyParams, EnvConfig, EnvParams
from medjax.physics import battery_energy, tractive_energy
from medjax.state import (
    IN_SERVICE,
    MERGING,
    NOT_BOOKED,
    RETIRED,
    EnvState,
    EVs,
    MEDs,
    Tally,
    Vehicles,
)
from medjax.traffic.car_following import (
    Platooning,
    by_kind,
    following_acceleration,
    gap_between,
    make_drivers,
    obstacle_acceleration,
)
from medjax.traffic.lane_change import Wish, decide, looking
from medjax.traffic.motion import ballistic_step, heading, lateral_step
from medjax.traffic.neighbours import NOBODY, find_neighbours, sort_by_road
from medjax.traffic.road import merge_distance


def vehicle_kinds(is_human: jax.Array, config: EnvConfig) -> jax.Array:
    """Kind of each slot, `(N,)` int32: its class by position, EVs by who drives."""
    return jnp.concatenate(
        [
            jnp.full((config.num_meds,), MED, jnp.int32),
            jnp.where(is_human, HUMAN_EV, AUTONOMOUS_EV).astype(jnp.int32),
            jnp.full((config.num_gas,), GAS, jnp.int32),
        ]
    )


def partners(vehicles: Vehicles, evs: EVs, length: jax.Array, config: EnvConfig) -> Partner:
    """The MED of each EV, `(E,)` fields; MED 0 stands in where an EV is not booked."""
    med = jnp.maximum(evs.med, 0)
    columns = (vehicles.x, vehicles.speed, vehicles.lane, length)
    return Partner(*(column[config.med_slots][med] for column in columns))


def drive_energy(before: jax.Array, after: jax.Array, body: BodyParams, dt: float) -> jax.Array:
    """Energy that a tick of driving takes from the battery, J; eqs (7)-(8) and the drivetrain."""
    wheels = tractive_energy(
        before,
        after,
        dt,
        mass=body.mass_kg,
        drag_coefficient=body.drag_coefficient,
        frontal_area=body.frontal_area_m2,
        rolling_resistance=body.rolling_resistance,
        rotational_inertia_factor=body.rotational_inertia_factor,
    )
    return battery_energy(
        wheels,
        dt,
        drivetrain_efficiency=body.drivetrain_efficiency,
        regeneration_efficiency=body.regeneration_efficiency,
        auxiliary_power=body.auxiliary_w,
    )


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


def _move(
    state: EnvState, tick: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[Vehicles, Tally]:
    """Perception, car following, docking control, lane changes and motion of all vehicles."""
    vehicles, evs = state.vehicles, state.evs
    kind = vehicle_kinds(evs.is_human, config)
    platooning = Platooning(params.charging.platoon_headway, params.charging.platoon_min_gap)
    drivers = make_drivers(
        vehicles.x,
        vehicles.speed,
        vehicles.desired_speed,
        kind,
        _platoons(state, config),
        params.drivers,
    )
    direction, group = looking(tick, config.lane_change_groups)
    target_lane = vehicles.lane + direction

    with jax.named_scope("neighbours"):
        order = sort_by_road(vehicles.x, vehicles.active, params.road.length_m, vehicles.road_order)
        neighbours = find_neighbours(
            order, vehicles.lane, target_lane, vehicles.active, config.num_lanes + 1
        )

    with jax.named_scope("car_following"):
        leader = drivers.at(neighbours.leader)
        has_leader = neighbours.leader != NOBODY
        following = following_acceleration(drivers, leader, has_leader, platooning)
        merging = vehicles.lane == config.num_lanes
        to_end = merge_distance(vehicles.x, params.road)
        acceleration = jnp.where(
            merging, jnp.minimum(following, obstacle_acceleration(drivers, to_end)), following
        )

    with jax.named_scope("docking"):
        ev_slots = config.ev_slots
        med = partners(vehicles, evs, drivers.length, config)
        approach = plan_approach(
            vehicles.x[ev_slots],
            vehicles.lane[ev_slots],
            drivers.length[ev_slots],
            evs.panel,
            med,
            params.charging,
        )
        docking = docking_acceleration(
            vehicles.x[ev_slots],
            vehicles.speed[ev_slots],
            approach.goal_x,
            med.speed,
            params.charging,
        )
        docking = jnp.where(evs.med != NOT_BOOKED, docking, jnp.inf)
        noisy = acceleration + vehicles.acceleration_noise
        command = noisy.at[ev_slots].set(
            jnp.minimum(noisy[ev_slots], docking + vehicles.acceleration_noise[ev_slots])
        )

    with jax.named_scope("lane_changes"):
        exists = (target_lane >= 0) & (target_lane < config.num_lanes)
        settled = jnp.abs(vehicles.lateral_offset) < 0.5 * params.road.lane_width_m
        changes = decide(
            drivers,
            neighbours,
            following,
            acceleration,
            direction,
            group,
            config.lane_change_groups,
            vehicles.active & exists & settled,
            _wishes(state, approach, to_end, config, params),
            platooning,
            params.lane_change,
        )

    with jax.named_scope("motion"):
        command = jnp.clip(command, -params.motion.max_braking, drivers.max_acceleration)
        x, speed = ballistic_step(vehicles.x, vehicles.speed, command, config.tick_s)
        shift = jnp.where(changes, direction * params.road.lane_width_m, 0.0)
        offset, lateral_speed = lateral_step(
            vehicles.lateral_offset - shift,
            vehicles.lateral_speed,
            vehicles.wander,
            params.motion.lateral_rate,
            config.tick_s,
        )
    overlapping = has_leader & (gap_between(drivers, leader) < 0.0)
    moved = vehicles.replace(
        x=jnp.where(vehicles.active, x, vehicles.x),
        speed=jnp.where(vehicles.active, speed, vehicles.speed),
        lane=jnp.where(changes, target_lane, vehicles.lane),
        lateral_offset=offset,
        lateral_speed=lateral_speed,
        road_order=order,
    )
    tally = Tally.zeros().replace(
        lane_changes=jnp.sum(changes, dtype=jnp.float32),
        collisions=jnp.sum(overlapping, dtype=jnp.float32),
    )
    return moved, tally


def _exchange(
    before: Vehicles, after: Vehicles, state: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[EVs, MEDs, Tally]:
    """Docking, transfer and driving energy of one tick."""
    evs, meds = state.evs, state.meds
    ev_slots, med_slots = config.ev_slots, config.med_slots
    length = by_kind(vehicle_kinds(evs.is_human, config), params.drivers.vehicle_length)
    med = partners(after, evs, length, config)
    partner = jnp.maximum(evs.med, 0)
    booked = evs.med != NOT_BOOKED

    with jax.named_scope("misalignment"):
        goal = panel_x(evs.panel, med, length[ev_slots], params.charging.dock_gap_m)
        error = after.x[ev_slots] - goal
        approach = plan_approach(
            after.x[ev_slots],
            after.lane[ev_slots],
            length[ev_slots],
            evs.panel,
            med,
            params.charging,
        )
        ev_heading, med_heading = (
            heading(after.speed[slots], after.lateral_speed[slots])
            for slots in (ev_slots, med_slots)
        )
        across = after.lateral_offset[ev_slots] - after.lateral_offset[med_slots][partner]
        is_charging = booked & is_docked(
            error,
            after.speed[ev_slots] - med.speed,
            approach.in_lane & (jnp.abs(across) < 0.25 * params.road.lane_width_m),
            evs.is_charging,
            params.charging,
        )
        geometry = misalignment(
            evs.panel,
            error,
            across,
            ev_heading - med_heading[partner],
            params.link.panel_gap_m,
        )
        efficiency = coupling_efficiency(geometry, params.link)

    with jax.named_scope("energy"):
        on_road = before.active[ev_slots]
        ev_use = jnp.where(
            on_road,
            drive_energy(before.speed[ev_slots], after.speed[ev_slots], params.ev, config.tick_s),
            0.0,
        )
        med_use = jnp.where(
            before.active[med_slots],
            drive_energy(
                before.speed[med_slots], after.speed[med_slots], params.med, config.tick_s
            ),
            0.0,
        )
        driven = evs.energy_j - ev_use
        flow = transfer(
            efficiency,
            is_charging,
            evs.med,
            meds.energy_j - params.fleet.reserve_soc * params.med_capacity_j,
            params.ev_capacity_j - driven,
            params.charging.slot_power_w * config.tick_s,
        )
        sent_by_med = jnp.zeros((config.num_meds,)).at[partner].add(flow.sent_j)
        ev_energy = jnp.clip(driven + flow.received_j, 0.0, params.ev_capacity_j)
        med_energy = jnp.clip(meds.energy_j - med_use - sent_by_med, 0.0, params.med_capacity_j)

    first = is_charging & ~evs.served
    tally = Tally.zeros().replace(
        energy_sent_j=jnp.sum(flow.sent_j),
        energy_received_j=jnp.sum(flow.received_j),
        evs_served=jnp.sum(first, dtype=jnp.float32),
    )
    evs = evs.replace(energy_j=ev_energy, is_charging=is_charging, served=evs.served | is_charging)
    return evs, meds.replace(energy_j=med_energy), tally


def _release(vehicles: Vehicles, evs: EVs, meds: MEDs, config: EnvConfig, params: EnvParams) -> EVs:
    """Ends bookings: charged, gone, out of time, or the MED is gone or empty."""
    booked = evs.med != NOT_BOOKED
    partner = jnp.maximum(evs.med, 0)
    has_energy = meds.energy_j > params.fleet.reserve_soc * params.med_capacity_j
    serves = (meds.status == IN_SERVICE) & vehicles.active[config.med_slots] & has_energy
    timer = jnp.where(
        booked,
        jnp.where(evs.is_charging, 0.0, evs.timer_s + config.tick_s),
        jnp.maximum(evs.timer_s - config.tick_s, 0.0),
    )
    late = booked & (timer > params.charging.patience_s)
    done = evs.energy_j >= params.charging.target_soc * params.ev_capacity_j
    ends = booked & (late | done | ~serves[partner] | ~vehicles.active[config.ev_slots])
    return evs.replace(
        med=jnp.where(ends, NOT_BOOKED, evs.med),
        panel=jnp.where(ends, NOT_BOOKED, evs.panel),
        is_charging=evs.is_charging & ~ends,
        timer_s=jnp.where(ends, jnp.where(late, params.charging.retry_s, 0.0), timer),
    )


def by_class(flags: jax.Array, config: EnvConfig) -> jax.Array:
    """Counts of `(N,)` flags over MEDs, EVs and gas vehicles, `(3,)` float32."""
    slices = (config.med_slots, config.ev_slots, config.gas_slots)
    return jnp.stack([jnp.sum(flags[s], dtype=jnp.float32) for s in slices])


def physics_tick(
    state: EnvState, tick: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, Tally]:
    """Advances one environment by `config.tick_s`.

    Args:
      state: of one environment.
      tick: () int32, ticks since reset; its parity says which way drivers look.

    Returns:
      (state after the tick, what happened in it). `state.tally` is left as it was.
    """
    before = state.vehicles
    after, moved = _move(state, tick, config, params)
    evs, meds, exchanged = _exchange(before, after, state, config, params)

    with jax.named_scope("exits"):
        left = before.active & (after.x > params.road.length_m)
        ran_out = jnp.zeros_like(left).at[config.ev_slots].set(evs.energy_j <= 0.0)
        depleted = before.active & ran_out & ~left
        active = before.active & ~left & ~depleted
        vehicles = after.replace(active=active)
        in_lane = after.lane[config.med_slots] == params.fleet.service_lane
        settled = jnp.abs(after.lateral_offset[config.med_slots]) < 1.0
        status = jnp.where((meds.status == MERGING) & in_lane & settled, IN_SERVICE, meds.status)
        gone = left[config.med_slots]
        meds = meds.replace(
            status=jnp.where(gone, RETIRED, status),
            ready_in_s=jnp.where(gone, params.fleet.turnaround_s, meds.ready_in_s),
        )
        evs = _release(vehicles, evs, meds, config, params)

    soc = evs.energy_j / params.ev_capacity_j
    travelled = jnp.where(before.active, after.x - before.x, 0.0)
    on_road = by_class(active, config)
    flow = Tally.zeros().replace(
        left=by_class(left, config),
        depleted=jnp.sum(depleted, dtype=jnp.float32),
        ev_seconds=on_road[1] * config.tick_s,
        ev_distance_m=jnp.sum(travelled[config.ev_slots]),
        soc_seconds=jnp.sum(jnp.where(active[config.ev_slots], soc, 0.0)) * config.tick_s,
        exit_soc=jnp.sum(jnp.where(left[config.ev_slots], soc, 0.0)),
        gas_seconds=on_road[2] * config.tick_s,
        gas_distance_m=jnp.sum(travelled[config.gas_slots]),
        vehicle_ticks=jnp.sum(on_road),
    )
    state = state.replace(vehicles=vehicles, evs=evs, meds=meds)
    return state, moved + exchanged + flow
