"""Environments so small that their values and best policies are known in closed form."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass
class ProbeParams:
    """Numbers of a probe."""

    episode_decisions: jax.Array | int = 5  # length of an episode
    reward: jax.Array | float = 1.0


@struct.dataclass
class ProbeState:
    """State of a probe."""

    time: jax.Array  # () int32
    cue: jax.Array  # () float32, what the observation shows
    total: jax.Array  # () float32, return so far


@dataclasses.dataclass(frozen=True)
class Probe:
    """A family of probes, chosen by `kind`.

    constant_truncated: reward 1 a step, truncated after `episode_decisions`; V = 1 / (1 - gamma).
    timed: the same, with a clock to be seen; V(t) = (1 - gamma^(T - t)) / (1 - gamma) if nothing follows.
    constant_terminated: the same but terminated; V(t) = (1 - gamma^(T - t)) / (1 - gamma).
    two_step: observation 0 then 1, reward 1 at the second step only, terminated; V = gamma, 1.
    follow: the cue is -1 or +1, new each step; reward 1 for action 1 on +1 and 0 on -1, else 0; one-step episodes.
    masked: as `follow`, but action 2 pays 10 and is forbidden.
    noisy: truncated at the end, the cue is random at every step; for shape and statistics tests.
    """

    kind: str
    num_actions: int = 2
    num_features: int = 2
    observation: Any = None  # a layout that no network knows
    recipe: Any = dataclasses.field(default=None, compare=False)  # how `make_probe` was called

    @property
    def name(self) -> str:
        return self.kind

    def observation_space(self, params: ProbeParams) -> Any:
        return SimpleNamespace(shape=(self.num_features,))

    def action_space(self, params: ProbeParams) -> Any:
        return SimpleNamespace(n=self.num_actions)

    def action_mask(self, state: ProbeState, params: ProbeParams) -> jax.Array:
        mask = jnp.ones((self.num_actions,), bool)
        return mask.at[2:].set(False) if self.kind == "masked" else mask

    def highway(self, state: ProbeState, params: ProbeParams) -> Any:
        return state, params

    def _observe(self, state: ProbeState) -> jax.Array:
        obs = jnp.zeros((self.num_features,), jnp.float32)
        if self.kind in ("timed", "constant_terminated", "two_step"):
            return obs.at[0].set(state.time.astype(jnp.float32))
        if self.kind in ("follow", "masked"):
            return obs.at[0].set(state.cue)
        if self.kind == "noisy":
            return obs.at[0].set(state.cue).at[1].set(state.time.astype(jnp.float32))
        return obs

    def _draw(self, key: jax.Array) -> jax.Array:
        if self.kind == "noisy":
            return jax.random.normal(key, (), jnp.float32)
        return jnp.where(jax.random.bernoulli(key), 1.0, -1.0).astype(jnp.float32)

    def reset(self, key: jax.Array, params: ProbeParams) -> tuple[jax.Array, ProbeState]:
        state = ProbeState(jnp.int32(0), self._draw(key), jnp.float32(0.0))
        return self._observe(state), state

    def step_env(
        self, key: jax.Array, state: ProbeState, action: jax.Array, params: ProbeParams
    ) -> tuple[Any, ...]:
        time = state.time + 1
        at_end = time >= params.episode_decisions
        no = jnp.bool_(False)
        reward, terminated, truncated = jnp.float32(params.reward), no, at_end
        if self.kind == "constant_terminated":
            terminated, truncated = at_end, no
        elif self.kind == "two_step":
            terminated, truncated = time >= 2, no
            reward = jnp.where(time >= 2, 1.0, 0.0)
        elif self.kind in ("follow", "masked"):
            terminated, truncated = jnp.bool_(True), no
            reward = jnp.where((action == 1) == (state.cue > 0), 1.0, 0.0)
            reward = jnp.where(action == 2, 10.0, reward)
        elif self.kind == "noisy":
            reward = 1.0 + state.cue + action.astype(jnp.float32)
        total = state.total + reward
        next_state = ProbeState(time, self._draw(key), total)
        info = {"metrics": {"total": total, "decisions": time.astype(jnp.float32)}}
        return self._observe(next_state), next_state, reward, terminated, truncated, info
