"""Episodes of different demand, so that what is learned holds for more than one."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.env.contract import Observation, Params, State
from medjax.env.wrapper import Wrapper
from medjax.errors import InputError, shown
from medjax.world.numbers import as_numbers
from medjax.world.params import Scalar

# Folded into the key of a reset, which goes on to the environment as it is: with a factor of 1 an episode
# is the one that would have been without the wrapper.
FACTOR = 0xDE3A4D


@struct.dataclass
class RandomDemandState:
    """State of `RandomDemand`."""

    env: Any  # state of the environment
    factor: jax.Array  # () float32, of the demand, the same for the whole episode

    @property
    def time(self) -> jax.Array:
        """() int32, decisions taken in the episode."""
        return self.env.time


def scale_demand(params: Params, factor: Scalar) -> Params:
    """`params`, with `demand` in them, with `factor` () times the vehicles asking to enter, at every entry alike."""
    flows = ("mainline_per_h", "ramp_per_h")
    scaled = {name: getattr(params.demand, name) * factor for name in flows}
    return params.replace(demand=params.demand.replace(**scaled))


@dataclasses.dataclass(frozen=True)
class RandomDemand(Wrapper):
    """`env` with a demand that is drawn for each episode (domain randomisation, Tobin et al. 2017, arXiv:1703.06907).

    A reset draws a factor, uniformly; the whole episode then has so many times the vehicles asking to enter that the
    parameters say. All that reads the parameters sees the demand drawn, observations that forecast it included.

    The road has the slots of its `EnvConfig` at any demand: who finds none free waits in the queue of an entry.

    Attributes:
        low: smallest factor, at least 0.
        high: largest factor, at least `low`.

    Raises:
        InputError: the factors are out of their range.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        super().__post_init__()
        factors = as_numbers([self.low, self.high])
        if factors is None or not 0.0 <= self.low <= self.high < math.inf:
            given = f"factors of the demand are {shown(self.low)} to {shown(self.high)}"
            raise InputError(f"{given}, must be at least 0 and ascending")

    def inner(self, state: RandomDemandState, params: Params) -> tuple[State, Params]:
        """State of the environment, and the parameters at the demand of the episode (None stays None)."""
        return state.env, None if params is None else scale_demand(params, state.factor)

    def outer(self, state: RandomDemandState, inner: State) -> RandomDemandState:
        """The same demand to the end of the episode."""
        return RandomDemandState(inner, state.factor)

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, RandomDemandState]:
        """Starts an episode of another demand."""
        own = jax.random.fold_in(key, FACTOR)
        factor = jax.random.uniform(own, (), jnp.float32, self.low, self.high)
        obs, state = self.env.reset(key, scale_demand(params, factor))
        return obs, RandomDemandState(state, factor)
