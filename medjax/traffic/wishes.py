"""What vehicles must do, or are told to: merges, exits, and the orders of charging."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import in_units, rounded
from medjax.traffic.exits import exit_desire, prepares
from medjax.traffic.following import Platooning
from medjax.traffic.lane_change import COURTEOUS_DESIRE, Wish
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import Vehicles

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


def wishes(
    vehicles: Vehicles,
    orders: Orders,
    to_end: jax.Array,
    straddles: jax.Array,
    direction: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> Wish:
    """Mandatory changes: off a ramp, towards an exit, and what is ordered; and who may change to the side looked at."""
    target = vehicles.lane + direction
    merging = vehicles.lane == config.num_lanes
    view_m = params.lane_change.view_m
    far = rounded(in_units(jnp.minimum(to_end, view_m), view_m))  # not inf, for gradients
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
        may=there & ~straddles,
    )
