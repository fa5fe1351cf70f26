"""A batch of environment copies, each reset in the step in which its episode ends."""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.env.contract import Environment, Observation, Params, State, StepResult
from medjax.env.wrapper import check_environment, whole_number_of
from medjax.errors import InputError
from medjax.numerics.rows import for_true_rows


@struct.dataclass
class BatchState:
    """State of `BatchAutoReset`."""

    env: Any  # states of the copies, every leaf (num_envs, ...)
    # (num_envs,) int32, decisions until the first episode is cut short; 0: no cut
    cut_in: jax.Array


@dataclasses.dataclass(frozen=True)
class BatchAutoReset:
    """Any number of copies of `env`, with same-step auto-reset.

    A finished copy returns the first observation of its next episode; `info["final_observation"]` holds the last one of
    the ended episode, from which a truncated episode must be bootstrapped. Fresh states are computed in pools of
    `reset_pool_size`, as many pools as the finished copies need and none if no copy finished. The cost of resets thus
    grows with the number of ended episodes, not of copies.

    Each copy has its own key, so its course does not depend on the other copies or the device
    (`medjax.wrappers.on_devices`).

    Attributes:
        env: environment to copy.
        reset_pool_size: resets computed together; 0 takes a 128th of the copies, at least 1.
        stagger: cuts each copy's first episode after a random number of decisions in 1..stagger, so that episodes of
            equal length do not all end together; 0 disables it. A cut is an ordinary truncation, marked in
            `info["cut_short"]` because its return is not that of a whole episode.
        group: this many adjacent copies start the same episodes as long as their episodes end together: they share
            arrivals, but each has its own driver noise. The number of copies must be a multiple of it.

    Raises:
        InputError: a number is out of its range.
    """

    env: Environment
    reset_pool_size: int = 0
    stagger: int = 0
    group: int = 1

    def __post_init__(self) -> None:
        check_environment(self.env)
        for name, least in (("reset_pool_size", 0), ("stagger", 0), ("group", 1)):
            whole_number_of(name, getattr(self, name), least)

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    def reset(self, keys: jax.Array, params: Params) -> tuple[Observation, BatchState]:
        """Starts a copy for each key `(num_envs,)`, all with the same params; observations are `(num_envs, ...)`."""
        reset_keys, stagger_keys = split_each(self._shared(keys))
        obs, env_state = jax.vmap(self.env.reset, (0, None))(reset_keys, params)
        cut_in = jnp.zeros(keys.shape, jnp.int32)
        if self.stagger:
            draw = partial(jax.random.randint, shape=(), minval=1, maxval=self.stagger + 1)
            cut_in = jax.vmap(partial(draw, dtype=jnp.int32))(stagger_keys)
        return obs, BatchState(env_state, cut_in)

    def step(
        self, keys: jax.Array, state: BatchState, actions: jax.Array, params: Params
    ) -> StepResult:
        """Takes one decision in every copy; keys `(num_envs,)`, actions `(num_envs,)` int32, the same params for all.

        Returns:
            obs, state, reward, terminated, truncated, info; every leaf `(num_envs, ...)`. In addition to the
            environment's info: `final_observation` and `final_action_mask` (before any reset), `action_mask` (of the
            returned state) and `cut_short` (see `stagger`).
        """
        step_keys, reset_keys = split_each(keys)
        step = jax.vmap(self.env.step_env, (0, 0, 0, None))
        result = step(step_keys, state.env, actions, params)
        obs, env_state, reward, terminated, truncated, info = result
        cut_short = (state.cut_in == 1) & ~(terminated | truncated)
        truncated = truncated | cut_short
        done = terminated | truncated
        cut_in = jnp.where(done, 0, jnp.maximum(state.cut_in - 1, 0))
        info = {**info, "final_observation": obs, "cut_short": cut_short}
        if "action_mask" not in info:  # an environment of one's own need not report it
            info["action_mask"] = jax.vmap(self.env.action_mask, (0, None))(env_state, params)
        info["final_action_mask"] = info["action_mask"]
        with jax.named_scope("auto_reset"):
            obs, env_state = self._restart(self._shared(reset_keys), done, obs, env_state, params)
        after = BatchState(env_state, cut_in)
        info["action_mask"] = self.action_mask(after, params)
        return obs, after, reward, terminated, truncated, info

    def action_mask(self, state: BatchState, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""
        return jax.vmap(self.env.action_mask, (0, None))(state.env, params)

    def _shared(self, keys: jax.Array) -> jax.Array:
        """Replaces each of `keys` `(num_envs,)` by the key of the first copy in its group."""
        if keys.shape[0] % self.group:
            raise InputError(
                f"num_envs is {keys.shape[0]}, must be a multiple of group = {self.group}"
            )
        groups = keys.reshape(-1, self.group)
        return jnp.broadcast_to(groups[:, :1], groups.shape).reshape(keys.shape)

    def _restart(
        self, keys: jax.Array, done: jax.Array, obs: Observation, state: State, params: Params
    ) -> tuple[Observation, State]:
        """Starts a new episode in every copy that is done; keys and done are `(num_envs,)`."""
        pool_size = min(done.shape[0], self.reset_pool_size or max(1, done.shape[0] // 128))

        def serve(_: jax.Array, rows: jax.Array, current: Any) -> Any:
            fresh = jax.vmap(self.env.reset, (0, None))(keys.at[rows].get(mode="clip"), params)
            return jax.tree.map(lambda x, new: x.at[rows].set(new, mode="drop"), current, fresh)

        return for_true_rows(done, pool_size, serve, (obs, state))


def split_each(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Splits each of `keys` `(num_envs,)` in two."""
    pairs = jax.vmap(jax.random.split)(keys)
    return pairs[:, 0], pairs[:, 1]
