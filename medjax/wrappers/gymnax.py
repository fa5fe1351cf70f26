"""Adapter for gymnax's wrappers and rollouts."""

from typing import Any

import jax
from gymnax.environments import spaces

from medjax.env.contract import Observation, Params, State, StepResult
from medjax.env.wrapper import check_environment


class GymnaxEnv:
    """`env` with default params and gymnax's own space classes, which gymnax's wrappers check.

    Apply it after all wrappers of medjax.

    Args:
      env: a single environment.
      default_params: its parameters, for calls that pass none.
    """

    def __init__(self, env: Any, default_params: Any) -> None:
        check_environment(env)
        self.env = env
        self.default_params = default_params

    def __getattr__(self, name: str) -> Any:
        if name == "env" or name.startswith("__"):  # during copying, `env` is not set yet
            raise AttributeError(name)
        return getattr(self.env, name)

    def _params(self, params: Params) -> Params:
        return self.default_params if params is None else params

    def reset(self, key: jax.Array, params: Params = None) -> tuple[Observation, State]:
        """Starts an episode."""
        started: tuple[Observation, State] = self.env.reset(key, self._params(params))
        return started

    def step(
        self, key: jax.Array, state: State, action: jax.Array, params: Params = None
    ) -> StepResult:
        """Takes one decision and resets in the same step when the episode ends; see `Wrapper.step`."""
        stepped: StepResult = self.env.step(key, state, action, self._params(params))
        return stepped

    def action_space(self, params: Params = None) -> Any:
        """Gymnax's `Discrete`."""
        return spaces.Discrete(self.env.action_space(self._params(params)).n)

    def observation_space(self, params: Params = None) -> Any:
        """Gymnax's `Box`."""
        own = self.env.observation_space(self._params(params))
        return spaces.Box(own.low, own.high, own.shape, own.dtype)
