"""Depots: which MEDs wait where, which one leaves next, and the trip home.

Each of several depots serves a group of adjacent ramps (`EnvConfig.ramp_depots`) and lies in the middle of them. A MED
returns to the depot that it came from, unless told otherwise. A single depot has no position: `fleet.turnaround_s`
covers the whole trip there and back.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from medjax.charging.energy import per_metre
from medjax.numerics.sums import scale_by
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, RETIRED, MEDs


def whole_fleet(config: EnvConfig, params: EnvParams) -> MEDs:
    """The full fleet, assigned to the depots in turn; slots beyond `fleet.size` stay retired and empty for good."""
    fleet, meds = params.fleet, config.num_meds
    exists = jnp.arange(meds, dtype=jnp.int32) < fleet.size
    return MEDs(
        energy_j=jnp.where(exists, params.med_capacity_j, 0.0).astype(jnp.float32),
        rest_j=jnp.zeros((meds,), jnp.float32),
        status=jnp.where(exists, AT_DEPOT, RETIRED).astype(jnp.int32),
        depot=jnp.arange(meds, dtype=jnp.int32) % config.num_depots,
        ramp=jnp.zeros((meds,), jnp.int32),
        ready_in_s=jnp.full((meds,), jnp.inf, jnp.float32),
        service_speed=jnp.full((meds,), fleet.service_speed, jnp.float32),
        service_lane=jnp.full((meds,), fleet.service_lane, jnp.int32),
        accepts=jnp.ones((meds,), bool),
    )


def own_ramps(meds: MEDs, config: EnvConfig) -> jax.Array:
    """Ramps that each MED's depot serves, `(num_meds, num_ramps)` bool."""
    return meds.depot[:, None] == jnp.asarray(config.ramp_depots, jnp.int32)


def next_to_be_sent(meds: MEDs) -> jax.Array:
    """The first waiting MED of each depot, `(num_meds,)` bool."""
    waits = meds.status == AT_DEPOT
    number = jnp.arange(meds.status.shape[0], dtype=jnp.int32)
    before = (number < number[:, None]) & (meds.depot == meds.depot[:, None])
    return waits & ~jnp.any(before & waits, axis=1)


def med_to_send(action: jax.Array, meds: MEDs, config: EnvConfig) -> jax.Array:
    """The MED that a dispatcher's action sends, if any, `(num_meds,)` bool; action () int32."""
    if not config.num_ramps:
        return jnp.zeros(meds.status.shape, bool)
    ramp = jnp.clip(action - 1, 0, config.num_ramps - 1)
    return (action > 0) & next_to_be_sent(meds) & own_ramps(meds, config)[:, ramp]


def distinct_depots(config: EnvConfig) -> int:
    """Number of depots worth observing separately: 0 if there is only one."""
    return config.num_depots if config.num_depots > 1 else 0


def shares_at_depots(meds: MEDs, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Share of the fleet that waits at each depot, `(distinct_depots,)`."""
    waits = (meds.status == AT_DEPOT)[:, None]
    here = waits & (meds.depot[:, None] == jnp.arange(distinct_depots(config)))
    return scale_by(jnp.sum(here, axis=0, dtype=jnp.int32), jnp.maximum(params.fleet.size, 1))


def depot_places(config: EnvConfig, params: EnvParams) -> jax.Array:
    """Mean position of each depot's ramps, `(num_depots,)` m along the road; requires at least one ramp."""
    serves = np.asarray(config.ramp_depots) == np.arange(config.num_depots)[:, None]
    shares = (serves / serves.sum(axis=1, keepdims=True)).astype(np.float32)
    return jnp.sum(shares * params.road.ramp_x_m, axis=1)


def trip_home(
    x: jax.Array, meds: MEDs, config: EnvConfig, params: EnvParams
) -> tuple[jax.Array, jax.Array]:
    """Travel time, s, and energy, J, from where each MED left the road, `(num_meds,)` m, to its depot, on the level.

    A MED drives home on its remaining energy, reserve included; the depot makes up any shortfall.
    """
    if config.num_depots == 1:
        return jnp.zeros_like(x), jnp.zeros_like(x)
    distance = jnp.abs(x - depot_places(config, params)[meds.depot])
    speed = jnp.asarray(params.fleet.return_speed)
    return distance / speed, distance * per_metre(speed, params.med, params.road.replace(slope=0.0))
