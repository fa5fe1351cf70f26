"""Acting in a batch of environments."""

from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct
from jax import lax

from medjax.wrappers import BatchEnvironment, for_true_rows
from train.algorithms.networks import PolicyWeights, apply_policy, apply_value, sample_each


@struct.dataclass
class RolloutState:
    """Where the environments stand between two rollouts."""

    env: Any  # state of the wrapped batch
    obs: jax.Array  # (num_envs, num_features), to act on next
    discounted_sum: jax.Array  # (num_envs,) discounted rewards of the running episode


@struct.dataclass
class Trajectory:
    """A rollout; every array is `(num_envs, num_steps, ...)`."""

    obs: jax.Array  # (..., num_features) as the environment returned them
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
    """Sums over the whole episodes that ended, in one array, which costs less to carry than one for each figure."""

    # "return", "length" and the environment's metrics
    names: tuple[str, ...] = struct.field(pytree_node=False)
    total: jax.Array  # (num_envs, len(names) + 1) float32, the number of episodes last


def start(env: BatchEnvironment, keys: jax.Array, env_params: Any) -> RolloutState:
    """Fresh episodes, one for each of the keys `(num_envs,)`."""
    obs, state = env.reset(keys, env_params)
    return RolloutState(state, obs, jnp.zeros(keys.shape, jnp.float32))


def values_where(
    network: nn.Module, weights: PolicyWeights, obs: jax.Array, mask: jax.Array, block: int
) -> jax.Array:
    """Values of the rows of `obs` `(num_rows, num_features)` where `mask`, computed for these only; else 0."""

    def fill(_: jax.Array, rows: jax.Array, out: jax.Array) -> jax.Array:
        picked = jnp.take(obs, rows, axis=0, mode="clip")
        return out.at[rows].set(apply_value(network, weights, picked), mode="drop")

    return for_true_rows(mask, block, fill, jnp.zeros(mask.shape, jnp.float32))


def sum_episodes(episode: dict[str, Any]) -> EpisodeSums:
    """The whole episodes that ended in a step.

    Args:
        episode: `info["episode"]` of `medjax.wrappers.EpisodeLog`.
    """
    values = {"return": episode["return"], "length": episode["length"], **episode["metrics"]}
    columns = [value.astype(jnp.float32) for value in values.values()]
    table = jnp.stack([*columns, jnp.ones_like(columns[0])], axis=1)
    return EpisodeSums(tuple(values), jnp.where(episode["complete"][:, None], table, 0.0))


def collect(
    env: BatchEnvironment,
    network: nn.Module,
    weights: PolicyWeights,
    state: RolloutState,
    keys: jax.Array,
    env_params: Any,
    *,
    num_steps: int,
    gamma: float,
) -> tuple[RolloutState, Trajectory, jax.Array, EpisodeSums]:
    """Acts for `num_steps` steps in some environments, each on its own.

    Args:
        env: batch whose steps report `info["episode"]` (`medjax.wrappers.EpisodeLog`).
        network: actor-critic.
        weights: its parameters and the moments that normalise observations, fixed for the whole rollout.
        state: where the environments stand.
        keys: `(num_envs,)`, randomness of policy and environment.
        env_params: parameters of the environments.
        num_steps: per environment.
        gamma: discount per step.

    Returns:
        The new state, the trajectory, the values `(num_envs,)` of the observations after it, sums over ended episodes.
    """
    few = max(1, keys.shape[0] // 64)

    def decide(
        carry: RolloutState, step_keys: jax.Array
    ) -> tuple[RolloutState, tuple[Trajectory, EpisodeSums]]:
        """One step in every environment, by keys `(num_envs, 2)`."""
        act_keys, env_keys = step_keys[:, 0], step_keys[:, 1]
        with jax.named_scope("act"):
            mask = env.action_mask(carry.env, env_params)
            policy, value = apply_policy(network, weights, carry.obs, mask)
            action = sample_each(policy, act_keys)
            log_prob = policy.log_prob(action)
        with jax.named_scope("environment"):
            obs, env_state, reward, terminated, truncated, info = env.step(
                env_keys, carry.env, action, env_params
            )
        with jax.named_scope("bootstrap"):
            cut = truncated & ~terminated
            final_value = values_where(network, weights, info["final_observation"], cut, few)
        reward = reward.astype(jnp.float32)
        discounted = gamma * carry.discounted_sum + reward
        step = Trajectory(
            obs=carry.obs,
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
        discounted = jnp.where(terminated | truncated, 0.0, discounted)
        return RolloutState(env_state, obs, discounted), (step, sum_episodes(info["episode"]))

    # (num_steps, num_envs, 2)
    step_keys = jax.vmap(lambda key: jax.random.split(key, (num_steps, 2)), out_axes=1)(keys)
    state, (trajectory, sums) = lax.scan(decide, state, step_keys)
    trajectory = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), trajectory)
    last_value = apply_value(network, weights, state.obs)
    return state, trajectory, last_value, jax.tree.map(lambda x: jnp.sum(x, axis=0), sums)
