"""Many copies of an environment, restarted within the step in which they finish."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh

from medjax.wrappers.devices import on_devices
from medjax.wrappers.protocol import Environment, Observation, Params, State, StepResult
from medjax.wrappers.rows import for_true_rows, in_blocks


@struct.dataclass
class BatchState:
    """State of `BatchAutoReset`."""

    env: Any  # states of the copies, every leaf (num_envs, ...)
    cut_in: (
        jax.Array
    )  # (num_envs,) int32, decisions until the first episode is cut short; 0: it is not


def reset_rows(env: Environment, keys: jax.Array, params: Params) -> tuple[Observation, State]:
    """`env.reset` with each of the keys `(rows,)`; every leaf of the result `(rows, ...)`."""
    return jax.vmap(env.reset, (0, None))(keys, params)


def step_rows(
    env: Environment, rows: tuple[jax.Array, State, jax.Array], params: Params
) -> StepResult:
    """`env.step_env`, without a reset, on rows of keys, states and actions; every leaf `(rows, ...)`."""
    step = jax.vmap(env.step_env, (0, 0, 0, None))
    return in_blocks(lambda key, state, action: step(key, state, action, params), *rows)


@dataclasses.dataclass(frozen=True)
class BatchAutoReset:
    """`num_envs` copies of `env` with same-step auto-reset.

    A finished copy returns the first observation of its next episode; the last one of the episode that ended is in
    `info["final_observation"]`, which is what a truncated episode must be bootstrapped from. Finished copies take
    fresh states from a pool of `reset_pool_size`, drawn only in steps in which any copy finished, and drawn again
    until all are served: the resets computed follow the episodes ended, not the number of copies.

    Attributes:
        env: environment to copy.
        num_envs: number of copies, at least 1.
        reset_pool_size: resets that a device computes together; 0 takes a 128th of its copies, at least 1.
        stagger: cuts each copy's first episode after a random number of decisions in 1..stagger, so that copies with
            episodes of one length do not all end together; 0 does not. A cut is an ordinary truncation, marked in
            `info["cut_short"]` because such an episode says nothing about a whole one's return.
        mesh: devices that share the copies (`medjax.wrappers.environment_mesh`); None leaves them where they are. No
            copy's course depends on it.

    Raises:
        ValueError: a number out of its range.
    """

    env: Environment
    num_envs: int
    reset_pool_size: int = 0
    stagger: int = 0
    mesh: Mesh | None = None

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.num_envs < 1:
            raise ValueError(f"num_envs is {self.num_envs}, must be at least 1")
        if self.reset_pool_size < 0:
            raise ValueError(f"reset_pool_size is {self.reset_pool_size}, must be at least 0")
        if self.stagger < 0:
            raise ValueError(f"stagger is {self.stagger}, must be at least 0")

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""
        return self.env.num_actions

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, BatchState]:
        """Starts all copies.

        Returns:
            Observations `(num_envs, ...)` and the state.
        """
        reset_key, stagger_key = jax.random.split(key)
        keys = jax.random.split(reset_key, self.num_envs)
        shape = (self.num_envs,)
        if self.stagger:
            cut_in = jax.random.randint(stagger_key, shape, 1, self.stagger + 1, jnp.int32)
        else:
            cut_in = jnp.zeros(shape, jnp.int32)
        return on_devices(self.mesh, self._start)((keys, cut_in), params)

    def step(
        self, key: jax.Array, state: BatchState, actions: jax.Array, params: Params
    ) -> StepResult:
        """One decision in every copy.

        Args:
            key: one key for the whole batch.
            state: state of the batch.
            actions: `(num_envs,)` int32.
            params: parameters, the same for all copies.

        Returns:
            obs, state, reward, terminated, truncated, info; every leaf `(num_envs, ...)`. Besides what the
            environment reports, info holds `final_observation` (the observation before any reset) and
            `cut_short` (see `stagger`).
        """
        # Each copy has its own keys, so that it takes the same course on any device and in any pool.
        keys = jax.random.split(key, (self.num_envs, 2))
        return on_devices(self.mesh, self._step)((keys, state, actions), params)

    def action_mask(self, state: BatchState, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""
        return jax.vmap(self.env.action_mask, (0, None))(state.env, params)

    def _start(
        self, rows: tuple[jax.Array, jax.Array], params: Params
    ) -> tuple[Observation, BatchState]:
        keys, cut_in = rows
        obs, env_state = reset_rows(self.env, keys, params)
        return obs, BatchState(env=env_state, cut_in=cut_in)

    def _step(self, rows: tuple[jax.Array, BatchState, jax.Array], params: Params) -> StepResult:
        """`step` for some of the copies: their keys `(rows, 2)`, states and actions."""
        keys, state, actions = rows
        obs, env_state, reward, terminated, truncated, info = step_rows(
            self.env, (keys[:, 0], state.env, actions), params
        )
        cut_short = (state.cut_in == 1) & ~(terminated | truncated)
        truncated = truncated | cut_short
        done = terminated | truncated
        cut_in = jnp.where(done, 0, jnp.maximum(state.cut_in - 1, 0))
        info = {**info, "final_observation": obs, "cut_short": cut_short}
        with jax.named_scope("auto_reset"):
            obs, env_state = self._restart(keys[:, 1], done, obs, env_state, params)
        next_state = BatchState(env=env_state, cut_in=cut_in)
        return obs, next_state, reward, terminated, truncated, info

    def _restart(
        self, keys: jax.Array, done: jax.Array, obs: Observation, state: State, params: Params
    ) -> tuple[Observation, State]:
        """Puts an own fresh episode into every copy that is done; keys, done `(rows,)`."""
        pool_size = min(done.shape[0], self.reset_pool_size or max(1, done.shape[0] // 128))

        def serve(_: jax.Array, rows: jax.Array, current: Any) -> Any:
            fresh = reset_rows(self.env, keys.at[rows].get(mode="clip"), params)
            return jax.tree.map(lambda x, new: x.at[rows].set(new, mode="drop"), current, fresh)

        return for_true_rows(done, pool_size, serve, (obs, state))
