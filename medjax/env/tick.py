"""One physics tick: car following, lane changes, motion, energy flows and exits."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.booking import release
from medjax.charging.docking import approach
from medjax.charging.exchange import exchange
from medjax.charging.link import Coupling, couple, links
from medjax.charging.stranded import leaves_road, run_out, without_motor
from medjax.env.dispatch import on_the_road
from medjax.numerics.sums import block_fma, scale_by, sum_pairwise
from medjax.traffic.exits import takes_exit
from medjax.traffic.following import CarFollowing, Drivers
from medjax.traffic.idm import IDM_PLUS
from medjax.traffic.incidents import hold, stand
from medjax.traffic.step import move
from medjax.world.kinds import GAS_KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, RETIRED, EnvState, EpisodeStats, EVs, Vehicles, count_kinds


def physics_tick(
    state: EnvState,
    drivers: Drivers,
    tick: jax.Array,
    config: EnvConfig,
    params: EnvParams,
    following: CarFollowing = IDM_PLUS,
    coupling: Coupling = couple,
) -> tuple[EnvState, EpisodeStats]:
    """Advances one environment by `config.tick_s`.

    Args:
      drivers: of its vehicles; constant within a round.
      tick: () int32, ticks since reset, or since the decision began where a decision covers whole cycles of
        `lane_change_groups`; its parity selects the side to which drivers look.
      following, coupling: as in `ChargingEnv`.

    Returns:
      (state after the tick, statistics of the tick). `state.stats` is unchanged.
    """
    slots = config.ev_slots
    with jax.named_scope("energy"):
        before = without_motor(state.vehicles, state.evs, config, params)
    with jax.named_scope("docking"):
        orders = approach(state, drivers, config, params)
    if (stands_for_s := state.stands_for_s) is not None:
        before, orders = hold(before, orders, drivers, stands_for_s, config)
    after, moved = move(before, drivers, orders, tick, config, params, following)
    with jax.named_scope("misalignment"):
        link = links(after, state.evs, drivers.length, config, params, coupling)
    with jax.named_scope("energy"):
        evs, meds, exchanged = exchange(before, after, link, state, config, params)
    with jax.named_scope("exits"):
        left = before.active & (after.x > params.road.length_m)
        if config.num_exits:
            left |= takes_exit(after, config, params)
        off_road = leaves_road(after, state.evs, config, params)
        stays = before.active & ~left
        after = after.replace(active=stays.at[slots].set(stays[slots] & ~off_road))
        evs, ran_out = run_out(after, evs, config)
        left = left.at[slots].set(left[slots] & ~evs.is_depleted)
        since_s = (tick % config.ticks_per_decision + 1) * config.tick_s
        meds = on_the_road(meds, after, left, since_s, config, params)
        evs = release(after, evs, meds, config, params)
    if stands_for_s is not None:
        state = state.replace(stands_for_s=stand(after, stands_for_s, config))
    with jax.named_scope("tally"):
        sent = (state.meds.status != AT_DEPOT) & (state.meds.status != RETIRED)
        flow = _flow(before, after, evs, sent, left, config, params)
        flow = flow.replace(depleted=jnp.sum(ran_out, dtype=jnp.float32))
    return state.replace(vehicles=after, evs=evs, meds=meds), moved + exchanged + flow


def _flow(
    before: Vehicles,
    after: Vehicles,
    evs: EVs,
    sent: jax.Array,
    left: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> EpisodeStats:
    """Occupancy, charge and departures of one tick; `sent` `(M,)` marks MEDs neither at a depot nor retired.

    A vehicle that `left` `(N,)` in the tick counts for all of it, since its distance counts in full.
    """
    ev_slots, gas_slots, on_road = config.ev_slots, config.gas_slots, before.active
    soc = block_fma(scale_by(evs.energy_j, params.ev_capacity_j))
    low = evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    goes_on = after.destination[ev_slots] >= params.road.length_m

    def seconds(there: jax.Array) -> jax.Array:
        return jnp.sum(there, dtype=jnp.float32) * config.tick_s

    return EpisodeStats.zeros().replace(
        left=count_kinds(left, before.kind, config),
        ev_seconds=seconds(on_road[ev_slots]),
        soc_seconds=sum_pairwise(jnp.where(on_road[ev_slots], soc, 0.0)) * config.tick_s,
        charging_stops=jnp.sum(left[ev_slots] & evs.stops, dtype=jnp.float32),
        exit_soc=sum_pairwise(jnp.where(left[ev_slots], soc, 0.0)),
        low_exits=jnp.sum(left[ev_slots] & (evs.stops | low & goes_on), dtype=jnp.float32),
        # The whole time on the road: `distances_driven` subtracts the free-flow time.
        ev_delay_s=seconds(on_road[ev_slots]),
        gas_delay_s=seconds(on_road[gas_slots]),
        med_seconds=seconds(sent),
        gas_seconds=jnp.stack([seconds(there) for there in _of_gas(on_road, before, config)]),
        vehicle_ticks=jnp.sum(after.active, dtype=jnp.float32),
    )


def distances_driven(before: Vehicles, after: Vehicles, config: EnvConfig) -> EpisodeStats:
    """Distances driven in a round; subtracts their duration at desired speed from the delays.

    Args:
      before, after: start and end of the round; a vehicle that left in between stays where it left.
    """
    travelled = after.x - before.x
    free_s = travelled / before.desired_speed
    return EpisodeStats.zeros().replace(
        ev_distance_m=sum_pairwise(travelled[config.ev_slots]),
        gas_distance_m=jnp.stack([sum_pairwise(x) for x in _of_gas(travelled, before, config)]),
        ev_delay_s=-sum_pairwise(free_s[config.ev_slots]),
        gas_delay_s=-sum_pairwise(free_s[config.gas_slots]),
    )


def means(
    state: EnvState, metres: jax.Array, ev_seconds: jax.Array, config: EnvConfig, params: EnvParams
) -> EpisodeStats:
    """A round's part of the integrals of the EVs' mean charge and mean speed; 0 on a road without EVs.

    Args:
      state: after the round; metres, ev_seconds: () distance and time that EVs spent on the road in it.
    """
    on_road = state.vehicles.active[config.ev_slots]
    charge = block_fma(scale_by(state.evs.energy_j, params.ev_capacity_j))
    evs = jnp.maximum(on_road.sum(dtype=jnp.int32), 1)
    soc = sum_pairwise(jnp.where(on_road, charge, 0.0)) / evs
    speed = jnp.where(ev_seconds > 0.0, metres / jnp.maximum(ev_seconds, 1e-6), 0.0)
    return EpisodeStats.zeros().replace(
        mean_soc_s=soc * config.round_s, mean_speed_m=speed * config.round_s
    )


def _of_gas(values: jax.Array, vehicles: Vehicles, config: EnvConfig) -> list[jax.Array]:
    """For each gas kind, the values `(N,)` in the gas slots, 0 for vehicles of other kinds."""
    kind, values = vehicles.kind[config.gas_slots], values[config.gas_slots]
    return [jnp.where(kind == each, values, 0) for each in GAS_KINDS]
