"""Dispatch actions and the life cycle of a MED: ramp queue, service, off the road, back at a depot."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.env.depots import med_to_send, own_ramps, trip_home, whole_fleet
from medjax.numerics.sums import count_down, sum_pairwise
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import (
    AT_DEPOT,
    IN_SERVICE,
    MERGING,
    QUEUED,
    RETIRED,
    EnvState,
    EpisodeStats,
    MEDs,
    Vehicles,
)


def action_names(config: EnvConfig, params: EnvParams) -> list[str]:
    """Display name of each action; params of one environment."""
    return ["none"] + [
        f"ramp {number} ({x:.0f} m)" for number, x in enumerate(params.road.ramp_x_m, 1)
    ]


def action_mask(state: EnvState, config: EnvConfig) -> jax.Array:
    """Allowed actions, `(1 + num_ramps,)` bool.

    Action 0 is always allowed; others if no cooldown is running and a MED waits at the depot of that ramp.
    """
    waits = (state.meds.status == AT_DEPOT)[:, None] & own_ramps(state.meds, config)
    can_send = (state.cooldown_s <= 0.0) & jnp.any(waits, axis=0)
    return jnp.concatenate([jnp.ones((1,), bool), can_send])


def is_allowed(choice: jax.Array, mask: jax.Array) -> jax.Array:
    """Whether choices `(...)` int32 are in range and allowed by their masks `(..., n)` bool."""
    num_choices = mask.shape[-1]
    index = jnp.clip(choice, 0, num_choices - 1)[..., None]
    allowed = jnp.take_along_axis(mask, index, axis=-1)[..., 0]
    return (choice >= 0) & (choice < num_choices) & allowed


def dispatch(
    state: EnvState, action: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, EpisodeStats]:
    """Sends a MED to a ramp, where it waits for a safe gap.

    Args:
      action: () integer; one that is out of range or masked counts as 0.

    Returns:
      (state, statistics of dispatches and invalid actions)
    """
    action, meds = jnp.asarray(action).astype(jnp.int32), state.meds
    allowed = is_allowed(action, action_mask(state, config))
    sent = allowed & (action > 0)
    chosen = sent & med_to_send(action, meds, config)
    meds = meds.replace(
        status=jnp.where(chosen, QUEUED, meds.status), ramp=jnp.where(chosen, action - 1, meds.ramp)
    )
    cooldown = jnp.where(sent, params.fleet.cooldown_s, state.cooldown_s)
    stats = EpisodeStats.zeros(0 * state.time).replace(  # a loop carry, see `EpisodeStats.zeros`
        meds_dispatched=sent.astype(jnp.float32), invalid_actions=(~allowed).astype(jnp.float32)
    )
    return state.replace(meds=meds, cooldown_s=cooldown), stats


def on_the_road(
    meds: MEDs,
    vehicles: Vehicles,
    left: jax.Array,
    since_s: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> MEDs:
    """MEDs after a tick: in service once settled in the service lane, retired once off the road.

    Args:
      left: (N,) bool, left at an exit or the end of the road in this tick.
      since_s: () s since the decision began, since `advance_clocks` subtracts the whole decision from the time away.
    """
    slots, fleet = config.med_slots, params.fleet
    in_lane = vehicles.lane[slots] == meds.service_lane
    settled = jnp.abs(vehicles.lateral_offset[slots]) < 1.0
    status = jnp.where((meds.status == MERGING) & in_lane & settled, IN_SERVICE, meds.status)
    home_s, home_j = trip_home(vehicles.x[slots], meds, config, params)
    charging_s = (params.med_capacity_j - meds.energy_j + home_j) / fleet.depot_power_w
    away_s = since_s + fleet.turnaround_s + home_s + charging_s
    return meds.replace(
        status=jnp.where(left[slots], RETIRED, status),
        ready_in_s=jnp.where(left[slots], away_s, meds.ready_in_s),
    )


def advance_clocks(
    state: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, EpisodeStats]:
    """Counts the decision, advances the cooldown, and returns fully charged MEDs to their depots.

    Returns:
      (state, statistics of energy from the depots and of energy for the trips home)
    """
    meds, dt = state.meds, config.decision_s
    ready_in = jnp.where(meds.status == RETIRED, count_down(meds.ready_in_s, dt), meds.ready_in_s)
    returns = (meds.status == RETIRED) & (ready_in <= 0.0)
    _, home_j = trip_home(state.vehicles.x[config.med_slots], meds, config, params)
    home_j = jnp.where(returns, home_j, 0.0)
    given_j = jnp.where(returns, params.med_capacity_j - meds.energy_j - meds.rest_j, 0.0) + home_j
    new = whole_fleet(config, params)
    fresh = ("energy_j", "rest_j", "service_speed", "service_lane")
    meds = meds.replace(
        status=jnp.where(returns, AT_DEPOT, meds.status),
        ready_in_s=ready_in,
        accepts=meds.accepts | returns,
        **{each: jnp.where(returns, getattr(new, each), getattr(meds, each)) for each in fresh},
    )
    cooldown_s = count_down(state.cooldown_s, dt)
    state = state.replace(meds=meds, cooldown_s=cooldown_s, time=state.time + 1)
    return state, EpisodeStats.zeros().replace(
        depot_energy_j=sum_pairwise(given_j), med_driving_j=sum_pairwise(home_j)
    )
