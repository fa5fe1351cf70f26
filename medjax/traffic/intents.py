"""Mandatory lane changes: merges, exits, and orders from charging."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma, scale_by
from medjax.traffic.exits import exit_desire, is_preparing_exit
from medjax.traffic.following import Platooning
from medjax.traffic.lane_change import COURTEOUS_DESIRE, LaneChangeIntent
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import Vehicles

# Urgency of ordered or still distant changes: just enough that others make room. Otherwise two MEDs side by side would
# block each other for ever.
ORDERED_DESIRE = 1.01 * COURTEOUS_DESIRE


class Orders(NamedTuple):
    """Requests to vehicles in a tick, `(N,)` except `platooning`."""

    platoon: jax.Array  # int32, vehicles with equal numbers form a platoon; NOBODY for none
    platooning: Platooning  # headway and gap within a platoon
    acceleration: jax.Array  # m/s^2, upper bound, inf for none
    desire: jax.Array  # -1 to 1, as in `LaneChangeIntent`; 0 for none
    stay: jax.Array  # bool: only mandatory changes


def make_intents(
    vehicles: Vehicles,
    orders: Orders,
    to_end: jax.Array,
    straddles: jax.Array,
    direction: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> LaneChangeIntent:
    """Mandatory changes (merging, exits, orders) and whether each vehicle may change to the side looked at."""
    target = vehicles.lane + direction
    merging = vehicles.lane == config.num_lanes
    view_m = params.lane_change.view_m
    far = block_fma(scale_by(jnp.minimum(to_end, view_m), view_m))  # finite, for gradients
    urgency = jnp.clip(1.0 - far, ORDERED_DESIRE, 1.0)
    there = vehicles.active & (target >= 0) & (target < config.num_lanes)
    wanted, stay = orders.desire, orders.stay | (vehicles.recovery_s > 0.0)
    if config.num_exits:
        leaves = is_preparing_exit(vehicles, config, params)
        wanted = jnp.where(leaves, exit_desire(vehicles, config, params), wanted)
        stay |= leaves
    return LaneChangeIntent(
        jnp.where(merging, -urgency, wanted), stay, may_change=there & ~straddles
    )
