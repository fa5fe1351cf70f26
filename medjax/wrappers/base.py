"""What a wrapper of one environment leaves as it is."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.contract import Environment, Observation, Params, State, StepResult


@dataclasses.dataclass(frozen=True)
class Wrapper:
    """`env` unchanged; a subclass says what it changes.

    Attributes:
        env: a single environment.
    """

    env: Environment

    @property
    def name(self) -> str:
        """Name of the environment."""
        return self.env.name

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode."""
        return self.env.reset(key, params)

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision."""
        return self.env.step_env(key, state, action, params)

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_actions,)` bool, True where the action is allowed."""
        return self.env.action_mask(state, params)

    def observation_space(self, params: Params) -> Any:
        """That of the environment."""
        return self.env.observation_space(params)


@dataclasses.dataclass(frozen=True)
class TimeLimitAsEnd(Wrapper):
    """`env` whose episodes terminate where it truncates them.

    For a learner whose policy sees the time left: nothing that it could do comes after the time limit, which is then
    a part of its task (Pardo et al. 2018, arXiv:1712.00378). Cuts by `BatchAutoReset`, which nobody sees coming, stay
    truncations.
    """

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision; truncated is always False."""
        obs, state, reward, terminated, truncated, info = self.env.step_env(
            key, state, action, params
        )
        return obs, state, reward, terminated | truncated, jnp.zeros_like(truncated), info
