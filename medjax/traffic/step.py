"""One tick of traffic: perception, car following, lane changes, motion."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from medjax.numerics.fusion import settled
from medjax.numerics.sums import count_down
from medjax.traffic.following import (
    FREE_GAP_M,
    CarFollowing,
    Drivers,
    Follower,
    Leader,
    by_kind,
    current_headway,
    following_acceleration,
    gap_between,
    gather_slots,
    leaders_and_followers,
    make_drivers,
    relaxed_headway,
    same_platoon,
)
from medjax.traffic.intents import Orders, make_intents
from medjax.traffic.lane_change import (
    CHANGE_LANE,
    CRAWL_M_PER_S,
    Follow,
    LaneChangeIntent,
    LaneChangePhase,
    Situation,
    decide,
    lane_change_phase,
    place_group,
    straddling_gap,
)
from medjax.traffic.motion import (
    Steering,
    ballistic_step,
    lateral_step,
    lateral_travel_time,
    ornstein_uhlenbeck,
    stopping_acceleration,
)
from medjax.traffic.neighbours import NOBODY, Neighbours, find_neighbours, sort_by_road
from medjax.traffic.road import (
    NO_LANE,
    clip_lateral_aim,
    merge_distance,
    spare_width,
    straddled_lane,
)
from medjax.traffic.safety import BrakingLimits, safe_acceleration, stopping_room
from medjax.world.params import EnvConfig, EnvParams, MotionParams
from medjax.world.state import IN_SERVICE, EnvState, EpisodeStats, Vehicles


def drivers_of(state: EnvState, config: EnvConfig, params: EnvParams) -> Drivers:
    """Drivers of all slots, `(N,)` each; they change only at a round of entries.

    A MED wants its own desired speed until it is in service, then its service speed.
    """
    vehicles, slots = state.vehicles, config.med_slots
    own = vehicles.desired_speed
    in_service = state.meds.status == IN_SERVICE
    med_speed = jnp.where(in_service, state.meds.service_speed, own[slots])
    return make_drivers(vehicles.kind, own.at[slots].set(med_speed), params.drivers)


def perturb(key: jax.Array, vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> Vehicles:
    """Advances drivers' noise and their recovery from lane changes by one round of entries."""
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


def _lane_changes(
    vehicles: Vehicles,
    situation: Situation,
    intent: LaneChangeIntent,
    phase: LaneChangePhase,
    follow: Follow,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[jax.Array, Vehicles]:
    """Lane steps of all vehicles in this tick, `(N,)` int32 in -1, 0, 1, and the vehicles with updated courtesy.

    The courtesy limit of a side holds until the vehicle looks there again.
    """
    limits = _braking_limits(config, params)
    decided = decide(situation, intent, phase, follow, params.lane_change, limits)
    left, right, is_left = vehicles.courtesy_left, vehicles.courtesy_right, phase.direction < 0
    seen = place_group(decided, phase, jnp.where(is_left, left, right))
    changes = seen == CHANGE_LANE
    recovery_s = jnp.where(changes, params.lane_change.recovery_s, vehicles.recovery_s)
    vehicles = vehicles.replace(
        courtesy_left=jnp.where(changes, jnp.inf, jnp.where(is_left, seen, left)),
        courtesy_right=jnp.where(changes, jnp.inf, jnp.where(is_left, right, seen)),
        recovery_s=recovery_s,
    )
    return phase.direction * changes, vehicles


def _step(
    vehicles: Vehicles,
    command: jax.Array,
    steps: jax.Array,
    width: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> Vehicles:
    """Moves vehicles by one tick: command m/s^2, steps -1, 0 or 1 lanes, width m, `(N,)` each."""
    lane_width = params.road.lane_width_m
    x, speed = ballistic_step(vehicles.x, vehicles.speed, command, config.tick_s)
    offset, lateral_speed = lateral_step(
        vehicles.lateral_offset - steps * lane_width,
        vehicles.lateral_speed,
        clip_lateral_aim(vehicles.wander, width, lane_width),
        _steering(speed, params.motion),
        config.tick_s,
    )
    return vehicles.replace(
        x=jnp.where(vehicles.active, x, vehicles.x),
        speed=jnp.where(vehicles.active, speed, vehicles.speed),
        lane=vehicles.lane + steps,
        lateral_offset=offset,
        lateral_speed=lateral_speed,
    )


def _steering(speed: jax.Array, motion: MotionParams) -> Steering:
    """Steering limits at speeds in m/s."""
    sideways = jnp.minimum(motion.lateral_speed, motion.lateral_slope * speed)
    return Steering(motion.lateral_rate, motion.lateral_acceleration, sideways)


def _clearing_time(speed: jax.Array, width: jax.Array, params: EnvParams) -> jax.Array:
    """Time in which vehicles of these speeds, m/s, and widths, m, would leave their lanes sideways, s."""
    steering = _steering(jnp.maximum(speed, CRAWL_M_PER_S), params.motion)
    clears_m = params.road.lane_width_m - spare_width(width, params.road.lane_width_m)
    return lateral_travel_time(clears_m, steering)


def _braking_limits(config: EnvConfig, params: EnvParams) -> BrakingLimits:
    return BrakingLimits(params.motion.max_braking, config.tick_s)


def _straddled_gap(
    followers: Follower, leaders: Leader, slots: jax.Array, straddles: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Gap to and speed of leaders, `slots`, in the second lane of straddling vehicles, `(N,)` each."""
    rear, speed = gather_slots((leaders.rear, leaders.speed), slots)
    is_there = straddles & (slots != NOBODY)
    return jnp.where(is_there, rear - followers.x, FREE_GAP_M), speed


def _max_safe_acceleration(
    vehicles: Vehicles,
    ahead: tuple[tuple[jax.Array, jax.Array], ...],
    to_end: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """Highest safe acceleration, m/s^2, behind leaders (gap, speed) and before the end of an acceleration lane."""
    limits = _braking_limits(config, params)
    rooms = (stopping_room(gap, speed, limits) for gap, speed in ahead)
    safe = safe_acceleration(vehicles.speed, jnp.minimum(*rooms), limits)
    braking = jnp.minimum(params.lane_change.safe_braking, limits.braking)
    stop = stopping_acceleration(vehicles.speed, to_end, braking, config.tick_s)
    return jnp.where(vehicles.lane == config.num_lanes, jnp.minimum(safe, stop), safe)


def _limited(
    following: jax.Array, safe: jax.Array, vehicles: Vehicles
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Both accelerations and the least of them and of courtesy, `(N,)` m/s^2 each.

    Lane changes and motion read them several times.
    """
    courtesy = jnp.minimum(vehicles.courtesy_left, vehicles.courtesy_right)
    least = jnp.minimum(jnp.minimum(following, safe), courtesy)
    return settled((following, safe, least), vehicles.road_order >= 0)


def _perceive(
    vehicles: Vehicles,
    drivers: Drivers,
    phase: LaneChangePhase,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[jax.Array, Neighbours]:
    """The order that the next sort begins with, `(N,)` slots, and everyone's neighbours.

    The target lane of a straddling vehicle is the second lane that it covers, so it considers no lane change.
    """
    x, lane, active, width = vehicles.x, vehicles.lane, vehicles.active, params.road.lane_width_m
    order = sort_by_road(x, active, params.road.length_m, vehicles.road_order)
    other = straddled_lane(lane, vehicles.lateral_offset, drivers.width, width)
    target = jnp.where(other != NO_LANE, other, lane + phase.direction)
    found = find_neighbours(order, lane, other, target, active, config.num_lanes + 1)
    # Elsewhere a sort gains nothing from the last order, and to carry it costs bytes.
    return order if jax.default_backend() == "cpu" else vehicles.road_order, found


def move(
    vehicles: Vehicles,
    drivers: Drivers,
    orders: Orders,
    tick: jax.Array,
    config: EnvConfig,
    params: EnvParams,
    model: CarFollowing,
) -> tuple[Vehicles, EpisodeStats]:
    """Moves all vehicles by one tick; the caller removes those that leave the road.

    Args:
      orders: requests to vehicles; car following and safety take precedence.
      tick: () int32; its parity decides to which side drivers look.
    """
    leaders, followers = leaders_and_followers(
        drivers, vehicles.x, vehicles.speed, orders.platoon, model
    )
    phase = lane_change_phase(tick, config.lane_change_groups)
    with jax.named_scope("neighbours"):
        order, neighbours = _perceive(vehicles, drivers, phase, config, params)
        straddles = neighbours.in_target()
    follow = functools.partial(following_acceleration, platooning=orders.platooning, model=model)
    with jax.named_scope("car_following"):
        leader, it_straddles = gather_slots((leaders, straddles), neighbours.leader)
        has_leader = neighbours.leader != NOBODY
        is_new = straddles | has_leader & it_straddles
        usual, dt = drivers.time_headway, config.tick_s
        current = current_headway(followers, leader, has_leader)
        headway = relaxed_headway(vehicles.headway, usual, current, is_new, dt, params.lane_change)
        together = same_platoon(followers, leader, has_leader)
        headway = jnp.where(together, orders.platooning.time_headway, headway)
        followers = followers._replace(time_headway=headway)
        following = follow(followers, leader, has_leader)
        to_end = merge_distance(vehicles.x, params.road)
        gap = jnp.where(has_leader, gap_between(followers, leader), FREE_GAP_M)
        aside, speed = _straddled_gap(followers, leaders, neighbours.target_leader, straddles)
        ahead = (gap, leader.speed), (aside - straddling_gap(followers), speed)
        safe = _max_safe_acceleration(vehicles, ahead, to_end - followers.min_gap, config, params)
        following, safe, acceleration = _limited(following, safe, vehicles)

    with jax.named_scope("lane_changes"):
        seen = neighbours.without_target(straddles)
        clearing_s = _clearing_time(vehicles.speed, drivers.width, params)
        situation = Situation(leaders, followers, usual, seen, clearing_s, following, acceleration)
        intent = make_intents(vehicles, orders, to_end, straddles, phase.direction, config, params)
        steps, vehicles = _lane_changes(vehicles, situation, intent, phase, follow, config, params)

    with jax.named_scope("motion"):
        command = jnp.minimum(acceleration, orders.acceleration)
        command = jnp.minimum(command + vehicles.acceleration_noise, safe)  # bounds noise, too
        command = jnp.clip(command, -params.motion.max_braking, followers.max_acceleration)
        vehicles = vehicles.replace(road_order=order, headway=headway)
        moved = _step(vehicles, command, steps, drivers.width, config, params)
    stats = EpisodeStats.zeros().replace(
        lane_changes=jnp.sum(jnp.abs(steps), dtype=jnp.float32),
        collisions=jnp.sum((gap < 0.0) | (aside < 0.0), dtype=jnp.float32),
    )
    return moved, stats
