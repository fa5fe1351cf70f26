"""Destinations, revised once per round: after a missed exit, for a charger, or for a depot."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.charging.energy import cruising
from medjax.charging.plugs import expected_waits
from medjax.numerics.gathers import read
from medjax.traffic.exits import has_missed_exit, is_preparing_exit, next_exit
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, LEAVING, NOT_BOOKED, EnvState, EpisodeStats, Vehicles

# A wait that is shorter by less than this is no reason to stop earlier. Chosen: above the half minute from an exit's
# first sign to its plugs, in which queues do not show who is on the way, and below a charge (16 min on `corridor`).
WORTHWHILE_S = 180.0


def lacks_charge(
    energy_j: jax.Array,
    x: jax.Array,
    destination: jax.Array,
    passed: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """EVs that would reach their destination, or the charger after an exit if nearer, with less than `stop_soc`.

    EVs drive at cruising speed. Each exit has a charger. The next one after the last exit is a mean exit spacing
    away, or at the road's end if that is farther.

    Args:
      energy_j, x, destination: of EVs, (E,) J, m, m.
      passed: (E,) m, the exit that each EV passes or has passed, or several, (num_exits, 1) m, for all EVs.

    Returns:
      (E,) bool, or (num_exits, E).
    """
    road = params.road
    beyond = next_exit(passed, road)
    spacing = road.length_m / config.num_exits
    outside = jnp.maximum(passed + spacing, road.length_m)
    beyond = jnp.where(beyond < road.length_m, beyond, outside)
    # An EV bound for the end of the road drives on beyond it.
    goal = jnp.where(destination < road.length_m, jnp.minimum(destination, beyond), beyond)
    speed, power_w = cruising(params)
    spare = energy_j - params.charging.stop_soc * params.ev_capacity_j
    return spare < (goal - x) * (power_w / speed)


def avoids_queue(
    state: EnvState, free_in_s: jax.Array, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """EVs that wait less for a plug at the exit ahead than at any later one within reach, `(E,)` bool.

    They lack charge for their whole way. Without queues they charge at the last exit that they reach with `stop_soc`
    left; they stop earlier where the wait is shorter by more than `WORTHWHILE_S` than at every later exit within reach.

    Args:
      state: at a round's start.
      free_in_s: `state.plugs_free_in_s`, which is not None.
    """
    slots = config.ev_slots
    x, destination = state.vehicles.x[slots], state.vehicles.destination[slots]
    exits, ahead = params.road.exit_x_m[:, None], next_exit(x, params.road)
    speed, _ = cruising(params)
    wait_s = expected_waits(free_in_s, exits - x, speed)
    lacks = lacks_charge(state.evs.energy_j, x, destination, exits, config, params)
    on_way = (exits >= ahead) & (exits < destination)
    # Who lacks no charge to go on at an exit reaches the next one.
    within_reach = on_way & (exits > ahead) & ~jnp.roll(lacks, 1, axis=0)
    here_s = jnp.where(exits == ahead, wait_s, jnp.inf).min(axis=0)
    later_s = jnp.where(within_reach, wait_s, jnp.inf).min(axis=0)
    return (on_way & lacks).any(axis=0) & (here_s + WORTHWHILE_S < later_s)


def needs_charger(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """EVs without a booking that leave at the exit ahead for a charger, `(E,)` bool.

    They do so because of `lacks_charge`, or because of `avoids_queue`, and decide between the exit's first sign and
    its deceleration lane.
    """
    vehicles, evs, road, slots = state.vehicles, state.evs, params.road, config.ev_slots
    x, destination = vehicles.x[slots], vehicles.destination[slots]
    ahead = next_exit(x, road)
    lacks = lacks_charge(evs.energy_j, x, destination, ahead, config, params)
    signed = (ahead < road.length_m) & (ahead - x <= road.exit_notice_m)
    passes = signed & (ahead - x >= road.exit_lane_m) & (destination > ahead)
    unserved = vehicles.active[slots] & (evs.med == NOT_BOOKED) & ~evs.is_depleted
    if evs.sees_queues is not None and state.plugs_free_in_s is not None:
        lacks |= evs.sees_queues & avoids_queue(state, state.plugs_free_in_s, config, params)
    return unserved & passes & lacks


def exit_in_time(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """The first exit at least `exit_notice_m` ahead of each MED, or the road's end, `(M,)` m."""
    return next_exit(vehicles.x[config.med_slots] + params.road.exit_notice_m, params.road)


def leaving_early(
    vehicles: Vehicles, leaves: jax.Array, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """Destinations, `(N,)` m, after redirecting the MEDs in `leaves` `(M,)` bool to the first exit they can take."""
    in_time, slots = exit_in_time(vehicles, config, params), config.med_slots
    of_meds = vehicles.destination[slots]
    early = jnp.where(leaves, jnp.minimum(in_time, of_meds), of_meds)
    return vehicles.destination.at[slots].set(early)


def plan_trips(
    state: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, EpisodeStats]:
    """Revises destinations: the next exit after a missed one, a charger for low EVs, a depot for MEDs at their reserve.

    An EV that makes for its exit, or whose MED does, gives up its booking and requests no other.

    Returns:
      (state, statistics of missed exits)
    """
    vehicles, meds, evs, road = state.vehicles, state.meds, state.evs, params.road
    slots = config.ev_slots
    past = has_missed_exit(vehicles, road)
    ahead = next_exit(vehicles.x, road)
    stops = needs_charger(state, config, params)
    empty = meds.energy_j <= params.fleet.reserve_soc * params.med_capacity_j
    vehicles = vehicles.replace(destination=jnp.where(past, ahead, vehicles.destination))
    destination = leaving_early(vehicles, empty & (meds.status == IN_SERVICE), config, params)
    of_evs = jnp.where(stops, ahead[slots], destination[slots])
    vehicles = vehicles.replace(destination=destination.at[slots].set(of_evs))
    near = is_preparing_exit(vehicles, config, params)
    leaves = (meds.status == IN_SERVICE) & near[config.med_slots]
    parts = near[slots] | evs.stops | stops
    parts |= (evs.med != NOT_BOOKED) & read(leaves, jnp.maximum(evs.med, 0))
    parts &= ~evs.is_depleted
    state = state.replace(
        vehicles=vehicles,
        meds=meds.replace(status=jnp.where(leaves, LEAVING, meds.status)),
        evs=evs.replace(
            med=jnp.where(parts, NOT_BOOKED, evs.med),
            charging_slot=jnp.where(parts, NOT_BOOKED, evs.charging_slot),
            is_charging=evs.is_charging & ~parts,
            retry_in_s=jnp.where(parts, config.round_s, evs.retry_in_s),
            stops=evs.stops | stops,
        ),
    )
    return state, EpisodeStats.zeros().replace(missed_exits=jnp.sum(past, dtype=jnp.float32))
