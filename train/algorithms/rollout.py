"""Rollouts in a batch of environments."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from medjax.env.contract import BatchEnvironment
from medjax.numerics import loops
from medjax.numerics.rows import for_true_rows
from train.algorithms.networks import Categorical, PolicyWeights, apply_policy, apply_value


@struct.dataclass
class RolloutState:
    """State of the environments between two rollouts."""

    env: Any  # state of the wrapped batch
    obs: jax.Array  # (num_envs, ..., num_features), to act on next
    discounted_sum: jax.Array  # (num_envs, ...) discounted rewards of the running episode


@struct.dataclass
class Trajectory:
    """A rollout; every array is `(num_steps, num_envs, ...)`, the order of acting, so that nothing is copied.

    If every MED is an agent, an axis of agents follows in all arrays except `terminated` and `truncated`.
    """

    obs: jax.Array  # (..., num_features), as the environment returned them
    mask: jax.Array  # (..., num_actions) bool, allowed actions
    action: jax.Array  # int32
    log_prob: jax.Array  # of the action
    value: jax.Array  # of the observation
    reward: jax.Array  # not scaled
    terminated: jax.Array  # bool
    truncated: jax.Array  # bool
    final_value: jax.Array  # value of the final observation where truncated, else 0
    discounted_sum: jax.Array  # discounted rewards of the episode up to this step


@struct.dataclass
class EpisodeSums:
    """Sums over the whole episodes that ended. One array is cheaper to carry than one per figure."""

    # "return", "length" and the environment's metrics
    names: tuple[str, ...] = struct.field(pytree_node=False)
    total: jax.Array  # (num_envs, len(names) + 1) float32; the last column counts episodes


def values_where(
    network: nn.Module, weights: PolicyWeights, obs: jax.Array, mask: jax.Array, block: int
) -> jax.Array:
    """Values of the rows of `obs` `(rows, ..., num_features)` where `mask` `(rows,)` holds; 0 elsewhere, uncomputed."""

    def fill(_: jax.Array, rows: jax.Array, out: jax.Array) -> jax.Array:
        picked = jnp.take(obs, rows, axis=0, mode="clip")
        return out.at[rows].set(apply_value(network, weights, picked), mode="drop")

    return for_true_rows(mask, block, fill, jnp.zeros(obs.shape[:-1], jnp.float32))


def spread(values: jax.Array, like: jax.Array) -> jax.Array:
    """`values` with trailing axes of length 1, to as many axes as `like` has."""
    return values.reshape(*values.shape, *[1] * (like.ndim - values.ndim))


def sum_episodes(episode: dict[str, Any]) -> EpisodeSums:
    """Sums over the whole episodes that ended in a step.

    Args:
        episode: `info["episode"]` of `medjax.wrappers.EpisodeLog`.
    """
    values = {"return": episode["return"], "length": episode["length"], **episode["metrics"]}
    columns = [value.astype(jnp.float32) for value in values.values()]
    table = jnp.stack([*columns, jnp.ones_like(columns[0])], axis=1)
    return EpisodeSums(tuple(values), jnp.where(episode["complete"][:, None], table, 0.0))


def episode_metrics(sums: EpisodeSums) -> dict[str, jax.Array]:
    """Means over the whole episodes that ended in the rollout; infinite if none did, as JAX_DEBUG_NANS stops at NaN."""
    *totals, count = jnp.sum(sums.total, axis=0)
    ended, divisor = count > 0.0, jnp.maximum(count, 1.0)
    means = (jnp.where(ended, each / divisor, jnp.inf) for each in totals)
    return {
        "episodes": count,
        **{f"episode_{name}": mean for name, mean in zip(sums.names, means, strict=True)},
    }


Choose = Callable[[Categorical, jax.Array], jax.Array]  # (rows,) policies and keys to actions


def sample_each(policy: Categorical, keys: jax.Array) -> jax.Array:
    """A sample from each of the distributions `(rows,)`, each with its own key `(rows,)`."""
    return jax.vmap(lambda own, key: own.sample(seed=key))(policy, keys)


@dataclasses.dataclass(frozen=True)
class Collector:
    """Acts in a batch of independent environments."""

    env: BatchEnvironment  # its steps report `info["episode"]` (`medjax.wrappers.EpisodeLog`)
    network: nn.Module  # gives logits and values
    num_steps: int  # per rollout and environment
    gamma: float  # discount per step

    def start(self, keys: jax.Array, env_params: Any) -> RolloutState:
        """Fresh episodes, one for each of the keys `(num_envs,)`."""
        obs, state = self.env.reset(keys, env_params)
        return RolloutState(state, obs, jnp.zeros(obs.shape[:-1], jnp.float32))

    def collect(
        self,
        weights: PolicyWeights,
        state: RolloutState,
        keys: jax.Array,
        env_params: Any,
        choose: Choose = sample_each,
    ) -> tuple[RolloutState, Trajectory, jax.Array, EpisodeSums]:
        """A rollout.

        Args:
            weights: parameters, and the moments that normalise observations; fixed for the whole rollout.
            state: state of the environments.
            keys: `(num_envs,)`, keys of policy and environment.
            env_params: parameters of the environments.
            choose: draws actions from the policies.

        Returns:
            The new state, the trajectory, the values `(num_envs, ...)` of the observations after it, and sums over
            ended episodes.
        """
        # (num_steps, num_envs, 2)
        split = jax.vmap(lambda key: jax.random.split(key, (self.num_steps, 2)), out_axes=1)
        step = partial(self._step, weights, env_params, choose)
        state, (trajectory, sums) = loops.scan(step, state, split(keys))
        last_value = apply_value(self.network, weights, state.obs)
        return state, trajectory, last_value, jax.tree.map(lambda x: jnp.sum(x, axis=0), sums)

    def _step(
        self,
        weights: PolicyWeights,
        env_params: Any,
        choose: Choose,
        state: RolloutState,
        keys: jax.Array,
    ) -> tuple[RolloutState, tuple[Trajectory, EpisodeSums]]:
        """One step in every environment, with keys `(num_envs, 2)`; arrays are `(num_envs, ...)`."""
        act_keys, env_keys = keys[:, 0], keys[:, 1]
        with jax.named_scope("act"):
            mask = self.env.action_mask(state.env, env_params)
            policy, value = apply_policy(self.network, weights, state.obs, mask)
            action = choose(policy, act_keys)
            log_prob = policy.log_prob(action)
        with jax.named_scope("environment"):
            obs, env_state, reward, terminated, truncated, info = self.env.step(
                env_keys, state.env, action, env_params
            )
        with jax.named_scope("bootstrap"):
            cut, few = truncated & ~terminated, max(1, keys.shape[0] // 64)
            final_value = values_where(self.network, weights, info["final_observation"], cut, few)
        # Each agent may have a reward of its own.
        reward = spread(info.get("rewards", reward), value).astype(jnp.float32)
        reward = jnp.broadcast_to(reward, value.shape)
        discounted = self.gamma * state.discounted_sum + reward
        step = Trajectory(
            obs=state.obs,
            mask=mask,
            action=action,
            log_prob=log_prob,
            value=value,
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            final_value=final_value,
            discounted_sum=discounted,
        )
        ended = spread(terminated | truncated, discounted)
        discounted = jnp.where(ended, 0.0, discounted)
        return RolloutState(env_state, obs, discounted), (step, sum_episodes(info["episode"]))
