"""Random demand per episode, so that policies generalise over demand."""

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

# Folded into the reset key to draw the factor. The environment gets the original key, so that a factor of 1
# reproduces the episode without the wrapper.
FACTOR = 0xDE3A4D


@struct.dataclass
class RandomDemandState:
    """State of `RandomDemand`."""

    env: Any  # state of the environment
    factor: jax.Array  # () float32, multiplies the demand for the whole episode

    @property
    def time(self) -> jax.Array:
        """() int32, decisions taken in the episode."""
        return self.env.time


def scale_demand(params: Params, factor: Scalar) -> Params:
    """Multiplies the demand in `params` by `factor` () at every entry."""
    flows = ("mainline_per_h", "ramp_per_h")
    scaled = {name: getattr(params.demand, name) * factor for name in flows}
    return params.replace(demand=params.demand.replace(**scaled))


@dataclasses.dataclass(frozen=True)
class RandomDemand(Wrapper):
    """`env` with random demand per episode (domain randomisation, Tobin et al. 2017, arXiv:1703.06907).

    A reset draws a uniform factor that multiplies the demand for the whole episode. Everything that reads the
    parameters, including observations that forecast demand, sees the drawn demand.

    The number of vehicle slots stays that of `EnvConfig`: a vehicle without a free slot waits in its entry's queue.

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
        """State of the environment, and parameters with the episode's demand (None stays None)."""
        return state.env, None if params is None else scale_demand(params, state.factor)

    def outer(self, state: RandomDemandState, inner: State) -> RandomDemandState:
        """Keeps the factor until the end of the episode."""
        return RandomDemandState(inner, state.factor)

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, RandomDemandState]:
        """Draws a demand and starts an episode with it."""
        own = jax.random.fold_in(key, FACTOR)
        factor = jax.random.uniform(own, (), jnp.float32, self.low, self.high)
        obs, state = self.env.reset(key, scale_demand(params, factor))
        return obs, RandomDemandState(state, factor)
