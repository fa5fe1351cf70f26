"""Keeps independent books of what happened, from states alone. `flows` keeps the books of energy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.verification.flows import CAPACITY_RTOL, driving, tick_flows, total
from medjax.world.kinds import GAS_KINDS, KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, RETIRED, EnvState, Vehicles

# Rounding error of positions, which are float32 numbers of up to thousands of metres.
ROUNDING_M = 2e-3


Ledger = dict[str, jax.Array]  # by the names of `EpisodeStats`, float32; energies are bounds (2,)


def sums_by_class(values: jax.Array, config: EnvConfig) -> jax.Array:
    """Sums over MEDs, EVs and gas vehicles, (3,) float32."""
    return jnp.stack([total(values[slots]) for slots in config.class_slots.values()])


def sums_by_kind(values: jax.Array, kind: jax.Array) -> jax.Array:
    """Sums over the vehicles of each kind, (num_kinds,) float32."""
    return jnp.zeros((len(KINDS),), jnp.float32).at[kind].add(values.astype(jnp.float32))


def entry_ledger(before: EnvState, begun: EnvState, length_m: Any) -> Ledger:
    """Ledger of dispatch, entries and missed exits."""
    past = before.vehicles.active & (before.vehicles.x > before.vehicles.destination)
    sent = (before.meds.status == AT_DEPOT) & (begun.meds.status != AT_DEPOT)
    come = begun.vehicles.active & ~before.vehicles.active
    return {
        "entered": sums_by_kind(come, begun.vehicles.kind),
        "meds_dispatched": total(sent),
        "missed_exits": total(past & (before.vehicles.destination < length_m)),
    }


def home_trip_energy(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Energy of each MED's trip from the road to its depot, (M,) J, at a constant speed on a level road."""
    if config.num_depots == 1:
        return jnp.zeros((config.num_meds,))
    speed, slots = params.fleet.return_speed, config.med_slots
    steady = state.vehicles.replace(
        speed=jnp.full_like(state.vehicles.speed, speed),
        active=jnp.ones_like(state.vehicles.active),
    )
    power, _ = driving(steady, steady, slots, params.med, params.road.replace(slope=0.0), 1.0)
    depots, ramp_x = np.array(config.ramp_depots), params.road.ramp_x_m
    served = [np.flatnonzero(depots == depot) for depot in range(config.num_depots)]
    middles = jnp.stack([jnp.mean(ramp_x[ramps]) for ramps in served])
    return power * jnp.abs(state.vehicles.x[slots] - middles[state.meds.depot]) / speed


def at_exit(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Vehicles in the rightmost lane beside the deceleration lane of their own exit, `(N,)` bool."""
    road = params.road
    before = road.exit_x_m[None, :] - vehicles.x[:, None]
    beside = (before >= -ROUNDING_M) & (before <= road.exit_lane_m + ROUNDING_M)
    own = beside & (vehicles.destination[:, None] == road.exit_x_m)
    centred = jnp.abs(vehicles.lateral_offset) < 0.25 * road.lane_width_m
    return own.any(axis=1) & centred & (vehicles.lane == config.num_lanes - 1)


def tick_ledger(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[dict[str, jax.Array], Ledger]:
    """Flags of impossible energy flows, by what is wrong, and the ledger of one tick."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    evs, was = after.evs, before.evs
    wrong, flows = tick_flows(before, after, config, params)
    gone = old.active & ~new.active
    on_energy = jnp.ones_like(gone).at[config.ev_slots].set(~was.is_depleted)
    past = (new.x > params.road.length_m) | at_exit(new, config, params)
    left = gone & on_energy & past
    bound = (new.destination[:, None] == params.road.exit_x_m).any(axis=1)[config.ev_slots]
    travelled = jnp.where(old.active, new.x - old.x, 0.0)
    soc = evs.energy_j / params.ev_capacity_j
    # Times and distances include the tick in which a vehicle leaves.
    there, distance = sums_by_class(old.active, config), sums_by_class(travelled, config)
    lost = jnp.where(old.active, dt - travelled / old.desired_speed, 0.0)
    delay, gas = sums_by_class(lost, config), jnp.array(GAS_KINDS)
    low = evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    on_their_way = (before.meds.status != AT_DEPOT) & (before.meds.status != RETIRED)
    ev_left = left[config.ev_slots]
    on_road = new.x[config.ev_slots] <= params.road.length_m
    at_plug = ev_left & was.stops & on_road & (config.num_plugs > 0)
    lacks_j = params.charging.plug_target_soc * params.ev_capacity_j - evs.energy_j
    taken_j = total(jnp.where(at_plug, jnp.maximum(lacks_j, 0.0), 0.0))
    slack_j = CAPACITY_RTOL * params.ev_capacity_j * total(at_plug)
    return wrong, flows | {
        "left": sums_by_kind(left, old.kind),
        "depleted": total(new.active[config.ev_slots] & evs.is_depleted & ~was.is_depleted),
        "ev_seconds": there[1] * dt,
        "ev_distance_m": distance[1],
        "soc_seconds": total(jnp.where(old.active[config.ev_slots], soc, 0.0)) * dt,
        "exit_soc": total(jnp.where(ev_left, soc, 0.0)),
        "low_exits": total(ev_left & (was.stops | low & ~bound)),
        "ev_delay_s": delay[1],
        "gas_delay_s": delay[2],
        "med_seconds": total(on_their_way) * dt,
        "gas_seconds": sums_by_kind(old.active, old.kind)[gas] * dt,
        "gas_distance_m": sums_by_kind(travelled, old.kind)[gas],
        "vehicle_ticks": total(new.active),
        "evs_served": total(evs.served & ~was.served),
        "lane_changes": total(jnp.where(old.active, jnp.abs(new.lane - old.lane), 0)),
        "charging_stops": total(ev_left & was.stops),
        "plug_stops": total(at_plug),
        "plug_energy_j": jnp.stack([taken_j - slack_j, taken_j + slack_j]),
    }
