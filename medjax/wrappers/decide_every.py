"""Decisions that stand for a while."""

import dataclasses
from typing import Any

import jax

from medjax.wrappers.protocol import Environment, Observation, Params, State, StepResult


def choices(mask: jax.Array, time: jax.Array, interval: int) -> jax.Array:
    """What is left of the allowed actions if all but 0 are considered at every `interval`-th decision only.

    Args:
        mask: `(num_actions,)` bool, what the environment allows.
        time: () int32, decisions taken in the episode.
        interval: at least 1; 1 leaves the mask as it is.
    """
    return mask.at[1:].set(mask[1:] & (time % interval == 0))


@dataclasses.dataclass(frozen=True)
class DecideEvery:
    """`env` for a policy that chooses at every `interval`-th decision and takes action 0 in between.

    A choice to wait then holds for the whole interval. Where waiting pays only if the next decisions wait too, a policy
    that may change its mind at each of them gains next to nothing from a single one, and does not learn it.

    Attributes:
        env: a single environment.
        interval: decisions from one choice to the next, at least 1.

    Raises:
        ValueError: the interval is out of its range.
    """

    env: Environment
    interval: int = 1

    def __post_init__(self) -> None:
        """Checks the number."""
        if self.interval < 1:
            raise ValueError(f"interval is {self.interval}, must be at least 1")

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
        """One decision, as the environment takes it."""
        return self.env.step_env(key, state, action, params)

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_actions,)` bool, see `choices`."""
        return choices(self.env.action_mask(state, params), state.time, self.interval)

    def observation_space(self, params: Params) -> Any:
        """That of the environment."""
        return self.env.observation_space(params)
