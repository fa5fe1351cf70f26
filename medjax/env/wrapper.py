"""Base class of wrappers of one environment."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from medjax.env.contract import Environment, Observation, Params, State, StepResult, step_with_reset
from medjax.errors import InputError, shown


def check_environment(env: Any) -> None:
    """Raises InputError unless env is an environment."""
    if not callable(getattr(env, "step_env", getattr(env, "step", None))):
        raise InputError(f"env is {shown(env)}: allowed an environment, as medjax.make gives it")


def whole_number_of(name: str, value: Any, least: int) -> None:
    """Raises InputError unless value is a whole number of at least `least`."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise InputError(f"{name} is {shown(value)}, must be a whole number, at least {least}")


@dataclasses.dataclass(frozen=True)
class Wrapper:
    """An `Environment` that passes everything on to `env`; subclasses override what they change.

    A subclass with its own state or parameters overrides `inner` and `outer` to convert them.

    Attributes:
        env: a single environment.
    """

    env: Environment

    def __post_init__(self) -> None:
        check_environment(self.env)

    def inner(self, state: State, params: Params) -> tuple[State, Params]:
        """Extracts the state and parameters of `env` from the wrapper's."""
        return state, params

    def outer(self, state: State, inner: State) -> State:
        """The wrapper's next state, from its previous `state` and the new state `inner` of `env`."""
        return inner

    @property
    def name(self) -> str:
        """Name of the environment."""
        return self.env.name

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    @property
    def config(self) -> Any:
        """Sizes and time steps of the highway."""
        return self.env.config

    @property
    def observation(self) -> Any:
        """Layout of the observation."""
        return self.env.observation

    @property
    def decisions_per_step(self) -> int:
        """Maximum number of highway decisions per step."""
        return self.env.decisions_per_step

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode."""
        return self.env.reset(key, params)

    def step(self, key: jax.Array, state: State, action: jax.Array, params: Params) -> StepResult:
        """Takes one decision and resets in the same step when the episode ends."""
        return step_with_reset(self, key, state, action, params)

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision."""
        inner, numbers = self.inner(state, params)
        obs, inner, *rest = self.env.step_env(key, inner, action, numbers)
        return obs, self.outer(state, inner), *rest

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_actions,)` bool, True where the action is allowed."""
        return self.env.action_mask(*self.inner(state, params))

    def get_obs(self, state: State, params: Params) -> Observation:
        """The policy's observation of a state."""
        return self.env.get_obs(*self.inner(state, params))

    def observe(self, state: State, params: Params) -> Any:
        """The structured observation."""
        return self.env.observe(*self.inner(state, params))

    def observation_space(self, params: Params = None) -> Any:
        """Observation space of `env`."""
        return self.env.observation_space(params)

    def action_space(self, params: Params = None) -> Any:
        """Action space of `env`."""
        return self.env.action_space(params)

    def render(self, state: State, params: Params = None, **size: int) -> Any:
        """A picture of a state."""
        return self.env.render(*self.inner(state, params), **size)

    def highway(self, state: State, params: Params) -> tuple[Any, Any]:
        """State and params of the highway, without any wrappers."""
        return self.env.highway(*self.inner(state, params))

    def with_probe(self, probe: Callable[[Any], Any] | None) -> Environment:
        """The same wrapper around an environment with this probe."""
        return dataclasses.replace(self, env=self.env.with_probe(probe))
