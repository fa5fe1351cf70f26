"""The state in which an episode starts: mid-traffic, no MED on the road."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.env.tick import by_class, drive_energy
from medjax.traffic.demand import desired_speeds, fill_road
from medjax.traffic.step import vehicle_kinds
from medjax.world.params import AUTONOMOUS_EV, EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, NOT_BOOKED, RETIRED, EnvState, EVs, MEDs, Tally, Vehicles


def _energy_per_metre(params: EnvParams) -> jax.Array:
    """Battery energy of an EV at the desired speed of an autonomous one, J/m."""
    cruise = params.drivers.desired_speed[AUTONOMOUS_EV]
    return drive_energy(cruise, cruise, params.ev, 1.0) / cruise


def _unserved(energy_j: jax.Array, is_human: jax.Array) -> EVs:
    """EVs with this energy `(E,)` and these drivers `(E,)` that no MED has served."""
    not_booked = jnp.full(energy_j.shape, NOT_BOOKED, jnp.int32)
    return EVs(
        energy_j=energy_j,
        rest_j=jnp.zeros(energy_j.shape),
        is_human=is_human,
        med=not_booked,
        panel=not_booked,
        is_charging=jnp.zeros(energy_j.shape, bool),
        timer_s=jnp.zeros(energy_j.shape),
        served=jnp.zeros(energy_j.shape, bool),
    )


def _at_depot(config: EnvConfig, params: EnvParams) -> MEDs:
    """The fleet, full and at the depot; slots beyond its size hold MEDs that never come."""
    exists = jnp.arange(config.num_meds) < params.fleet.size
    return MEDs(
        energy_j=jnp.full((config.num_meds,), params.med_capacity_j, jnp.float32),
        rest_j=jnp.zeros((config.num_meds,)),
        status=jnp.where(exists, AT_DEPOT, RETIRED).astype(jnp.int32),
        ramp=jnp.zeros((config.num_meds,), jnp.int32),
        ready_in_s=jnp.full((config.num_meds,), jnp.inf, jnp.float32),
    )


def initial_state(key: jax.Array, config: EnvConfig, params: EnvParams) -> EnvState:
    """Draws a road already filled to match the demand.

    EVs on the road have spent what the way to their place takes since they arrived; those whose
    energy would not have lasted are not there, just as in the flow without MEDs.
    """
    demand, drivers = params.demand, params.drivers
    speed_key, human_key, soc_key, fill_key, noise_key, next_key = jax.random.split(key, 6)
    is_human = jax.random.uniform(human_key, (config.num_evs,)) < demand.human_share
    kind = vehicle_kinds(is_human, config)
    draw = jax.random.normal(speed_key, (config.num_vehicles,))
    desired = desired_speeds(draw, kind, drivers)
    desired = desired.at[config.med_slots].set(params.fleet.service_speed)

    ordinary = slice(config.num_meds, config.num_vehicles)
    is_ev = jnp.arange(config.num_evs + config.num_gas) < config.num_evs
    fill = fill_road(
        fill_key,
        is_ev,
        desired[ordinary],
        demand,
        params.road,
        drivers,
        config.num_lanes,
        params.motion.max_braking,
    )
    arrival = jax.random.uniform(
        soc_key,
        (config.num_evs,),
        minval=demand.arrival_soc_low,
        maxval=demand.arrival_soc_high,
    )
    energy = arrival * params.ev_capacity_j - fill.x[: config.num_evs] * _energy_per_metre(params)
    alive = jnp.concatenate([energy > 0.0, jnp.ones((config.num_gas,), bool)])

    def with_meds(values: jax.Array) -> jax.Array:
        return jnp.concatenate([jnp.zeros((config.num_meds,), values.dtype), values])

    active = with_meds(fill.active & alive)
    noise = jax.random.normal(noise_key, (2, config.num_vehicles))
    still = jnp.zeros((config.num_vehicles,))
    wander = noise[1] * drivers.lateral_wander[kind]
    vehicles = Vehicles(
        x=with_meds(fill.x),
        speed=with_meds(fill.speed),
        lane=with_meds(fill.lane),
        active=active,
        lateral_offset=wander,
        lateral_speed=still,
        desired_speed=desired,
        acceleration_noise=noise[0] * drivers.acceleration_noise[kind],
        wander=wander,
        road_order=jnp.arange(config.num_vehicles, dtype=jnp.int32),
    )
    return EnvState(
        vehicles=vehicles,
        evs=_unserved(jnp.maximum(energy, 0.0), is_human),
        meds=_at_depot(config, params),
        queue=jnp.zeros((config.num_entries,), jnp.int32),
        next_is_ev=jax.random.bernoulli(next_key, demand.ev_share, (config.num_entries,)),
        cooldown_s=jnp.zeros(()),
        time=jnp.zeros((), jnp.int32),
        tally=Tally.zeros().replace(entered=by_class(active, config)),
    )
