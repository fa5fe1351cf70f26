"""The initial state of an episode: traffic on the road, all MEDs at their depots."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.booking import unserved
from medjax.charging.energy import cruising
from medjax.env.depots import whole_fleet
from medjax.env.trips import lacks_charge
from medjax.numerics.sums import block_fma
from medjax.traffic.arrivals import draw_surges, new_seed
from medjax.traffic.demand import (
    desired_speeds,
    drawn_kinds,
    entry_rates,
    fill_road,
    shares_on_road,
)
from medjax.traffic.exits import draw_destinations_on_road, draw_origins, last_exit
from medjax.traffic.road import clip_lateral_aim
from medjax.world.kinds import MED
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, EpisodeStats, Vehicles, count_kinds


def initial_state(key: jax.Array, config: EnvConfig, params: EnvParams) -> EnvState:
    """Draws a road already filled to match the demand.

    EVs have spent the energy of the distance from where they entered. As in the flow without MEDs, EVs that would have
    run out or left for a charger are absent.
    """
    demand, slots, shape = params.demand, config.traffic_slots, (config.num_evs,)
    road_key, soc_key, driver_key, arrivals_key = jax.random.split(key, 4)
    vehicles, origin = _filled(road_key, config, params)
    low, high = demand.arrival_soc_low, demand.arrival_soc_high
    arrival = low + block_fma(jax.random.uniform(soc_key, shape, jnp.float32) * (high - low))
    luck = jax.random.uniform(driver_key, shape, jnp.float32)
    complies = luck < params.drivers.eco_compliance
    sees = None
    if config.num_plugs:
        luck = jax.random.uniform(jax.random.fold_in(driver_key, 0), shape, jnp.float32)
        sees = luck < params.charging.queue_seen_share
    speed, power_w = cruising(params)
    x = vehicles.x[config.ev_slots]
    distance = x - origin
    # Downhill, driving may gain. The bound separates product and sum as `block_fma` does, and cuts only what exceeds a
    # full battery.
    spent = jnp.maximum(distance * (power_w / speed), -params.ev_capacity_j)
    energy = block_fma(arrival * params.ev_capacity_j) - spent
    stayed = energy > 0.0
    if config.num_exits:
        stayed &= ~_left_before(vehicles, distance, energy, config, params)
    alive = config.by_slot(True, stayed, True)[slots]
    # Filter traffic slots only. XLA recomputes the energy for the observation in one kernel with this filter, and the
    # rest of that kernel decides its last bits: filtering the whole array would break reproduction of recorded runs.
    active = _beside_meds(vehicles.active[slots] & alive, config)
    arrivals = new_seed(arrivals_key)
    return EnvState(
        vehicles=vehicles.replace(active=active),
        evs=unserved(jnp.clip(energy, 0.0, params.ev_capacity_j), complies, sees),
        meds=whole_fleet(config, params),
        queue=jnp.zeros((config.num_entries,), jnp.int32),
        entered_here=jnp.zeros((config.num_entries,), jnp.int32),
        detected_per_s=_detected(config, params),
        arrivals=arrivals,
        surges=draw_surges(arrivals, config) if config.num_surges else None,
        plugs_free_in_s=_plugs(config),
        stands_for_s=jnp.zeros((config.num_gas,), jnp.float32) if config.num_incidents else None,
        cooldown_s=jnp.zeros((), jnp.float32),
        time=jnp.zeros((), jnp.int32),
        # Copies: who donates a state that was made outside `jit` needs a buffer of its own for each number.
        stats=jax.tree.map(jnp.copy, EpisodeStats.zeros()).replace(
            entered=count_kinds(active, vehicles.kind, config)
        ),
    )


def _detected(config: EnvConfig, params: EnvParams) -> jax.Array | None:
    """What detectors show at reset, the demand for which the road is filled, `(num_entries,)`; None without them."""
    start_s = jnp.zeros((), jnp.float32)
    return entry_rates(params.demand, config.num_lanes, start_s) if config.has_detectors else None


def _plugs(config: EnvConfig) -> jax.Array | None:
    """Plugs that are all free, `(num_exits, num_plugs)` s; None without plugs."""
    shape = config.num_exits, config.num_plugs
    return jnp.zeros(shape, jnp.float32) if config.num_plugs else None


def _left_before(
    vehicles: Vehicles,
    distance_m: jax.Array,
    energy_j: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """EVs that would have left for a charger at the last exit whose deceleration lane they came by; `(E,)` bool.

    distance_m `(E,)` is how far they have driven.
    Past speed is assumed constant, so an EV that lacks charge now already lacked it when that exit was signed.
    """
    x, destination = vehicles.x[config.ev_slots], vehicles.destination[config.ev_slots]
    passed = last_exit(x + params.road.exit_lane_m, params.road)
    lacks = lacks_charge(energy_j, x, destination, passed, config, params)
    return lacks & (passed - params.road.exit_lane_m >= x - distance_m)


def _filled(key: jax.Array, config: EnvConfig, params: EnvParams) -> tuple[Vehicles, jax.Array]:
    """Vehicles of a road that carries traffic but no MED, and where its EVs entered, `(E,)` m."""
    speed_key, kind_key, fill_key, way_key, noise_key = jax.random.split(key, 5)
    drivers, slots = params.drivers, config.traffic_slots

    is_ev = config.by_slot(False, True, False)[slots]
    shares = shares_on_road(params.demand, drivers)
    kind = drawn_kinds(jax.random.uniform(kind_key, is_ev.shape, jnp.float32), is_ev, shares)
    kind = _beside_meds(kind, config, MED)
    desired = desired_speeds(jax.random.normal(speed_key, kind.shape, jnp.float32), kind, drivers)
    fill = fill_road(fill_key, kind[slots], desired[slots], config.num_lanes, params)
    way_draw = jax.random.uniform(way_key, (2, *fill.x.shape), jnp.float32)
    origin = draw_origins(way_draw[0], fill.x, params.demand, params.road)
    to_go = config.num_lanes - 1 - fill.lane
    destination = draw_destinations_on_road(way_draw[1], fill.x, origin, to_go, config, params)
    noise = jax.random.normal(noise_key, (2, config.num_vehicles), jnp.float32)
    wander = noise[1] * drivers.lateral_wander[kind]
    width = drivers.vehicle_width[kind]
    vehicles = Vehicles(
        x=_beside_meds(fill.x, config),
        speed=_beside_meds(fill.speed, config),
        lane=_beside_meds(fill.lane, config),
        active=_beside_meds(fill.active, config),
        kind=kind,
        lateral_offset=clip_lateral_aim(wander, width, params.road.lane_width_m),
        lateral_speed=jnp.zeros((config.num_vehicles,), jnp.float32),
        desired_speed=desired,
        acceleration_noise=noise[0] * drivers.acceleration_noise[kind],
        wander=wander,
        headway=drivers.time_headway[kind],
        courtesy_left=jnp.full_like(desired, jnp.inf),
        courtesy_right=jnp.full_like(desired, jnp.inf),
        recovery_s=jnp.zeros((config.num_vehicles,), jnp.float32),
        destination=_beside_meds(destination, config),
        road_order=jnp.arange(config.num_vehicles, dtype=jnp.int32),
    )
    return vehicles, _beside_meds(origin, config)[config.ev_slots]


def _beside_meds(values: jax.Array, config: EnvConfig, of_meds: int = 0) -> jax.Array:
    """Extends values of the traffic slots `(C,)` by one value for all MEDs, to `(num_vehicles,)`."""
    blank = jnp.full((config.num_vehicles,), of_meds, values.dtype)
    return blank.at[config.traffic_slots].set(values)
