"""Return, length and metrics of finished episodes."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.env.contract import Observation, Params, StepResult
from medjax.env.wrapper import check_environment
from medjax.wrappers.auto_reset import BatchAutoReset


@struct.dataclass
class EpisodeLogState:
    """State of `EpisodeLog`; every array is `(num_envs,)`."""

    env: Any  # state of the wrapped batch
    episode_return: jax.Array  # float32, undiscounted return of the running episode so far
    episode_length: jax.Array  # int32, decisions of the running episode so far
    episode_parts: dict[str, jax.Array]  # float32, return so far by weighted reward term


@dataclasses.dataclass(frozen=True)
class EpisodeLog:
    """Adds `info["episode"]` to a batch of environments.

    It holds, each `(num_envs,)`: `finished` (bool, the episode ended in this step), `complete` (bool, it ended and was
    not cut short by staggering), and `return`, `length` and `metrics` (a dict) of the step's episode up to and
    including this step. The metrics include `reward_NAME`, the return by weighted reward term, for each term in
    `params.reward_weights`.

    Raises:
        InputError: `env` is not an environment.
    """

    env: BatchAutoReset

    def __post_init__(self) -> None:
        check_environment(self.env)

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    def reset(self, keys: jax.Array, params: Params) -> tuple[Observation, EpisodeLogState]:
        """Starts all copies; see `BatchAutoReset.reset`."""
        obs, state = self.env.reset(keys, params)
        zeros = jnp.zeros(keys.shape, jnp.float32)
        parts = dict.fromkeys(getattr(params, "reward_weights", {}), zeros)
        return obs, EpisodeLogState(state, zeros, jnp.zeros(keys.shape, jnp.int32), parts)

    def step(
        self, keys: jax.Array, state: EpisodeLogState, actions: jax.Array, params: Params
    ) -> StepResult:
        """Takes one decision in every copy; see `BatchAutoReset.step`."""
        result = self.env.step(keys, state.env, actions, params)
        obs, env_state, reward, terminated, truncated, info = result
        done = terminated | truncated
        total = state.episode_return + reward.astype(jnp.float32)
        length = state.episode_length + 1
        terms = info.get("reward_terms", {})
        parts = {
            name: so_far + terms.get(name, 0.0) for name, so_far in state.episode_parts.items()
        }
        next_state = EpisodeLogState(
            env_state,
            jnp.where(done, 0.0, total),
            jnp.where(done, 0, length),
            {name: jnp.where(done, 0.0, part) for name, part in parts.items()},
        )
        named = {f"reward_{name}": part for name, part in parts.items()}
        episode = {"finished": done, "complete": done & ~info["cut_short"]}
        episode |= {"return": total, "length": length, "metrics": {**info["metrics"], **named}}
        return obs, next_state, reward, terminated, truncated, {**info, "episode": episode}

    def action_mask(self, state: EpisodeLogState, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""
        return self.env.action_mask(state.env, params)
