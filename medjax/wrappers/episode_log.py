"""Return, length and metrics of finished episodes."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.wrappers.auto_reset import BatchAutoReset
from medjax.wrappers.protocol import Observation, Params, StepResult


@struct.dataclass
class EpisodeLogState:
    """State of `EpisodeLog`; every array is `(num_envs,)`."""

    env: Any  # state of the wrapped batch
    episode_return: jax.Array  # float32, undiscounted sum of rewards of the running episode
    episode_length: jax.Array  # int32, decisions of the running episode
    last_return: jax.Array  # float32, of the last finished episode; 0 before the first
    last_length: jax.Array  # int32, of the last finished episode; 0 before the first
    last_metrics: dict[str, jax.Array]  # float32, of the last finished episode; 0 before the first


@dataclasses.dataclass(frozen=True)
class EpisodeLog:
    """Adds `info["episode"]` to a batch of environments.

    `info["episode"]` holds, each `(num_envs,)`: `finished` (bool, an episode ended in this step), `complete` (bool, and
    it was not cut short by staggering), `return`, `length` and `metrics` (a dict) of the last finished episode.
    """

    env: BatchAutoReset

    @property
    def num_envs(self) -> int:
        """Number of copies."""
        return self.env.num_envs

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, EpisodeLogState]:
        """Starts all copies; see `BatchAutoReset.reset`."""
        obs, state = self.env.reset(key, params)
        zeros = jnp.zeros((self.num_envs,), jnp.float32)
        counts = jnp.zeros((self.num_envs,), jnp.int32)
        # Only a step says which metrics there are; eval_shape looks at one without computing it.
        actions = jnp.zeros((self.num_envs,), jnp.int32)
        info = jax.eval_shape(self.env.step, key, state, actions, params)[-1]
        metrics = dict.fromkeys(info["metrics"], zeros)
        return obs, EpisodeLogState(state, zeros, counts, zeros, counts, metrics)

    def step(
        self, key: jax.Array, state: EpisodeLogState, actions: jax.Array, params: Params
    ) -> StepResult:
        """One decision in every copy; see `BatchAutoReset.step`."""
        obs, env_state, reward, terminated, truncated, info = self.env.step(
            key, state.env, actions, params
        )
        done = terminated | truncated
        total = state.episode_return + reward.astype(jnp.float32)
        length = state.episode_length + 1
        last_metrics = {
            name: jnp.where(done, info["metrics"][name].astype(jnp.float32), old)
            for name, old in state.last_metrics.items()
        }
        next_state = EpisodeLogState(
            env=env_state,
            episode_return=jnp.where(done, 0.0, total),
            episode_length=jnp.where(done, 0, length),
            last_return=jnp.where(done, total, state.last_return),
            last_length=jnp.where(done, length, state.last_length),
            last_metrics=last_metrics,
        )
        episode = {
            "finished": done,
            "complete": done & ~info["cut_short"],
            "return": next_state.last_return,
            "length": next_state.last_length,
            "metrics": last_metrics,
        }
        return obs, next_state, reward, terminated, truncated, {**info, "episode": episode}

    def action_mask(self, state: EpisodeLogState, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""
        return self.env.action_mask(state.env, params)
