"""How all vehicles move in a tick: perception, car following, lane changes, motion."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import count_down, in_units, rounded
from medjax.traffic.exits import exit_desire, prepares
from medjax.traffic.following import (
    FREE_GAP_M,
    CarFollowing,
    Drivers,
    Platooning,
    by_kind,
    following_acceleration,
    gap_between,
    make_drivers,
    of_slots,
    relaxed_headway,
    roles,
    same_platoon,
    spare_headway,
)
from medjax.traffic.lane_change import (
    COURTEOUS_DESIRE,
    GOES,
    Follow,
    Situation,
    Turn,
    Wish,
    decide,
    place_group,
    whose_turn,
)
from medjax.traffic.motion import (
    Steering,
    ballistic_step,
    lateral_step,
    ornstein_uhlenbeck,
    stopping_acceleration,
)
from medjax.traffic.neighbours import NOBODY, find_neighbours, sort_by_road
from medjax.traffic.road import merge_distance
from medjax.traffic.safety import Tyres, safe_acceleration
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, EnvState, Tally, Vehicles

# What is ordered, or still far off, is so urgent: just enough that others make room, or two MEDs side by side would
# stay so for good.
ORDERED_DESIRE = 1.01 * COURTEOUS_DESIRE


class Orders(NamedTuple):
    """What others than its driver want of each vehicle in a tick, `(N,)` but for `platooning`."""

    platoon: jax.Array  # int32, vehicles of one number keep together, NOBODY: of none
    platooning: Platooning  # how close
    acceleration: jax.Array  # m/s^2 at most, inf where nobody cares
    desire: jax.Array  # -1 to 1, as `medjax.traffic.lane_change.Wish`; 0 need not change lanes
    stay: jax.Array  # bool: no change but a mandatory one


def drivers_of(state: EnvState, config: EnvConfig, params: EnvParams) -> Drivers:
    """Drivers of all slots, `(N,)` each; they stay the same between two rounds of entries.

    A MED drives with its own desired speed until it is in service, then at its service speed.
    """
    vehicles, slots = state.vehicles, config.med_slots
    own = vehicles.desired_speed
    in_service = state.meds.status == IN_SERVICE
    med_speed = jnp.where(in_service, state.meds.service_speed, own[slots])
    return make_drivers(vehicles.kind, own.at[slots].set(med_speed), params.drivers)


def perturb(key: jax.Array, vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> Vehicles:
    """Drivers' noise moves on once a round of entries, and they recover from lane changes; between rounds both stay."""
    drivers = params.drivers
    normal = jax.random.normal(key, (2, config.num_vehicles), jnp.float32)
    time_s, dt = params.motion.noise_time_s, config.round_s
    noise, wander = (
        ornstein_uhlenbeck(value, draw, by_kind(vehicles.kind, std), time_s, dt)
        for value, draw, std in (
            (vehicles.acceleration_noise, normal[0], drivers.acceleration_noise),
            (vehicles.wander, normal[1], drivers.lateral_wander),
        )
    )
    recovery_s = count_down(vehicles.recovery_s, dt)
    return vehicles.replace(acceleration_noise=noise, wander=wander, recovery_s=recovery_s)


def _is_changing(vehicles: Vehicles, params: EnvParams) -> jax.Array:
    """Whether each is nearer to the lane that it comes from, `(N,)` bool."""
    return jnp.abs(vehicles.lateral_offset) >= 0.5 * params.road.lane_width_m


def _wishes(
    vehicles: Vehicles,
    orders: Orders,
    to_end: jax.Array,
    direction: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> Wish:
    """Mandatory changes: off a ramp, towards an exit, and what is ordered; and who may change to the side looked at."""
    target = vehicles.lane + direction
    merging = vehicles.lane == config.num_lanes
    far = rounded(in_units(to_end, params.lane_change.view_m))
    urgency = jnp.clip(1.0 - far, ORDERED_DESIRE, 1.0)
    there = vehicles.active & (target >= 0) & (target < config.num_lanes)
    wanted = orders.desire
    stay = orders.stay | (vehicles.recovery_s > 0.0)
    if config.num_exits:
        leaves = prepares(vehicles, config, params)
        wanted = jnp.where(leaves, exit_desire(vehicles, config, params), wanted)
        stay |= leaves
    return Wish(
        desire=jnp.where(merging, -urgency, wanted),
        stay=stay,
        may=there & ~_is_changing(vehicles, params),
    )


def _lane_changes(
    vehicles: Vehicles,
    situation: Situation,
    wish: Wish,
    turn: Turn,
    follow: Follow,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[jax.Array, Vehicles]:
    """Lane steps of all vehicles in this tick, `(N,)` int32 in -1, 0, 1; the vehicles, courteous."""
    tyres = _tyres(config, params)
    decided = decide(situation, wish, turn, follow, params.lane_change, tyres)
    seen = place_group(decided, turn, vehicles.courtesy)
    changes = seen == GOES
    recovery_s = jnp.where(changes, params.lane_change.recovery_s, vehicles.recovery_s)
    courtesy = jnp.where(changes, jnp.inf, seen)
    return turn.direction * changes, vehicles.replace(courtesy=courtesy, recovery_s=recovery_s)


def _step(
    vehicles: Vehicles, command: jax.Array, steps: jax.Array, config: EnvConfig, params: EnvParams
) -> Vehicles:
    """Motion of one tick under accelerations `(N,)` m/s2 and lane changes `(N,)` of -1, 0 or 1."""
    x, speed = ballistic_step(vehicles.x, vehicles.speed, command, config.tick_s)
    motion = params.motion
    sideways = jnp.minimum(motion.lateral_speed, motion.lateral_slope * speed)
    offset, lateral_speed = lateral_step(
        vehicles.lateral_offset - steps * params.road.lane_width_m,
        vehicles.lateral_speed,
        vehicles.wander,
        Steering(motion.lateral_rate, motion.lateral_acceleration, sideways),
        config.tick_s,
    )
    return vehicles.replace(
        x=jnp.where(vehicles.active, x, vehicles.x),
        speed=jnp.where(vehicles.active, speed, vehicles.speed),
        lane=vehicles.lane + steps,
        lateral_offset=offset,
        lateral_speed=lateral_speed,
    )


def _tyres(config: EnvConfig, params: EnvParams) -> Tyres:
    return Tyres(params.motion.max_braking, config.tick_s)


def _most(
    vehicles: Vehicles,
    gap: jax.Array,
    leader_speed: jax.Array,
    room: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """What the one ahead, at a gap `(N,)` m, allows, and the end of an acceleration lane, with room `(N,)` m, m/s^2."""
    tyres = _tyres(config, params)
    safe = safe_acceleration(vehicles.speed, gap, leader_speed, tyres)
    braking = jnp.minimum(params.lane_change.safe_braking, tyres.braking)
    stop = stopping_acceleration(vehicles.speed, room, braking, config.tick_s)
    return jnp.where(vehicles.lane == config.num_lanes, jnp.minimum(safe, stop), safe)


def move(
    vehicles: Vehicles,
    drivers: Drivers,
    orders: Orders,
    tick: jax.Array,
    config: EnvConfig,
    params: EnvParams,
    model: CarFollowing,
) -> tuple[Vehicles, Tally]:
    """Moves all vehicles by one tick; who leaves the road is not yet taken off it.

    Args:
      vehicles: of one environment; drivers: theirs.
      orders: what others want of them; car following and safety come first.
      tick: () int32; its parity says which way drivers look.
    """
    leaders, followers = roles(drivers, vehicles.x, vehicles.speed, orders.platoon, model)
    turn = whose_turn(tick, config.lane_change_groups)
    with jax.named_scope("neighbours"):
        order = sort_by_road(vehicles.x, vehicles.active, params.road.length_m, vehicles.road_order)
        target, lanes = vehicles.lane + turn.direction, config.num_lanes + 1
        neighbours = find_neighbours(order, vehicles.lane, target, vehicles.active, lanes)

    follow = functools.partial(following_acceleration, platooning=orders.platooning, model=model)
    with jax.named_scope("car_following"):
        changing = _is_changing(vehicles, params)
        leader, its_changing = of_slots((leaders, changing), neighbours.leader)
        has_leader = neighbours.leader != NOBODY
        is_new = changing | has_leader & its_changing
        spare = spare_headway(followers, leader, has_leader)
        kept = vehicles.headway, drivers.time_headway, spare
        headway = relaxed_headway(*kept, is_new, config.tick_s, params.lane_change)
        together = same_platoon(followers, leader, has_leader)
        headway = jnp.where(together, orders.platooning.time_headway, headway)
        followers = followers._replace(time_headway=headway)
        following = follow(followers, leader, has_leader)
        to_end = merge_distance(vehicles.x, params.road)
        gap = jnp.where(has_leader, gap_between(followers, leader), FREE_GAP_M)
        most = _most(vehicles, gap, leader.speed, to_end - followers.min_gap, config, params)
        acceleration = jnp.minimum(jnp.minimum(following, most), vehicles.courtesy)

    with jax.named_scope("lane_changes"):
        usual, courtesy = drivers.time_headway, vehicles.courtesy
        seen = leaders, followers, usual, neighbours, courtesy, following, acceleration
        wish = _wishes(vehicles, orders, to_end, turn.direction, config, params)
        steps, vehicles = _lane_changes(
            vehicles, Situation(*seen), wish, turn, follow, config, params
        )

    with jax.named_scope("motion"):
        command = jnp.minimum(acceleration, orders.acceleration)
        command = jnp.minimum(command + vehicles.acceleration_noise, most)  # noise goes no further
        command = jnp.clip(command, -params.motion.max_braking, followers.max_acceleration)
        moved = _step(vehicles, command, steps, config, params)
        moved = moved.replace(road_order=order, headway=headway)
    tally = Tally.zeros().replace(
        lane_changes=jnp.sum(jnp.abs(steps), dtype=jnp.float32),
        collisions=jnp.sum(gap < 0.0, dtype=jnp.float32),
    )
    return moved, tally
