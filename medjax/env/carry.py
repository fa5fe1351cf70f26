"""What the loop over ticks keeps in memory: on a GPU as few bytes as hold the same numbers.

A GPU reads and writes them in every tick, and bytes set its pace. A CPU has them in its caches, and would pay for the
conversions: 2 % of a decision.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from medjax.traffic.following import Drivers, make_drivers
from medjax.world.params import DriverParams
from medjax.world.state import EnvState


def packed(state: EnvState) -> EnvState:
    """The state with lanes and kinds in 8 bits; on a CPU the state itself."""
    return _with_integers(state, jnp.int8)


def unpacked(state: EnvState) -> EnvState:
    """The state that was `packed`."""
    return _with_integers(state, jnp.int32)


def _with_integers(state: EnvState, dtype: DTypeLike) -> EnvState:
    if jax.default_backend() == "cpu":
        return state
    vehicles = state.vehicles
    lane, kind = vehicles.lane.astype(dtype), vehicles.kind.astype(dtype)
    return state.replace(vehicles=vehicles.replace(lane=lane, kind=kind))


def looked_up(drivers: Drivers, kind: jax.Array, params: DriverParams) -> Drivers:
    """The same drivers; on a GPU read from the table of kinds in every tick, not from eight arrays in memory.

    Args:
      drivers: `(N,)` each; kind: `(N,)` int32, of their vehicles.
      params: that they were made from.
    """
    if jax.default_backend() == "cpu":
        return drivers
    with jax.named_scope("car_following"):
        return make_drivers(kind, drivers.desired_speed, params)
