"""What the wrappers and the trainer ask of an environment.

Anything with these members can be wrapped and trained: `medjax.env.ChargingEnv` is one, the small probe
environments of `tests/train/probe_envs.py` are others.
"""

from typing import Any, Protocol

import jax

Observation = Any
State = Any
Params = Any
Info = dict[str, Any]
StepResult = tuple[Observation, State, jax.Array, jax.Array, jax.Array, Info]


class Environment(Protocol):
    """One environment, written for a single episode and vectorised by the caller with `jax.vmap`.

    Its states have `time`, () int32: decisions taken in the episode.
    """

    @property
    def name(self) -> str:
        """Name for people."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions; action 0 is always allowed."""

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode."""

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision without reset: obs, state, reward, terminated, truncated, info.

        `info["metrics"]` maps names to float32 scalars describing the episode so far.
        """

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_actions,)` bool, True where the action is allowed."""

    def observation_space(self, params: Params) -> Any:
        """A space with the attribute `shape`."""


class BatchEnvironment(Protocol):
    """Many copies of an environment that are reset and stepped together; axis 0 is the environment."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""

    def reset(self, keys: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode in a copy for each of the keys `(num_envs,)`."""

    def step(self, keys: jax.Array, state: State, actions: jax.Array, params: Params) -> StepResult:
        """One decision in every copy, keys `(num_envs,)`; finished copies restart within the same step."""

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""
