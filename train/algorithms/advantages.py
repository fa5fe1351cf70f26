"""Generalised advantage estimation that distinguishes terminations from truncations."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax import lax


@struct.dataclass
class Steps:
    """Inputs of the advantage estimate; every array is `(num_steps, ...)`, or broadcasts to it."""

    reward: jax.Array
    value: jax.Array  # of the observation that the action was chosen for
    terminated: jax.Array  # bool
    truncated: jax.Array  # bool
    final_value: jax.Array  # of the final observation; read only where truncated


def generalized_advantages(
    steps: Steps, last_value: jax.Array, *, gamma: float, gae_lambda: float
) -> tuple[jax.Array, jax.Array]:
    """GAE(lambda) over rollouts with auto-reset: how much better a choice did than the critic expected.

    A_t = delta_t + gamma lambda A_(t+1), with delta_t = r_t + gamma V_(t+1) - V_t (Schulman et al. 2016,
    arXiv:1506.02438, eq. 16).

    A terminated episode has no future value. A truncated one would have continued: it is bootstrapped with the value
    of its final observation, and the trace is cut because the next stored step belongs to another episode. A step that
    both terminates and truncates counts as a termination.

    Args:
        steps: steps of the rollouts.
        last_value: `(...)`, value of the observation after the last step (of a new episode if that step ended one).
        gamma: discount per step.
        gae_lambda: trace decay per step.

    Returns:
        Advantages and value targets (`advantage + value`), both `(num_steps, ...)`.
    """
    value, terminated, truncated = steps.value, steps.terminated, steps.truncated
    next_value = jnp.concatenate([value[1:], last_value[None]])
    next_value = jnp.where(truncated, steps.final_value, next_value)
    next_value = jnp.where(terminated, 0.0, next_value)
    delta = steps.reward + gamma * next_value - value
    decay = jnp.where(terminated | truncated, 0.0, gamma * gae_lambda)

    def back(advantage: jax.Array, step: Any) -> tuple[jax.Array, jax.Array]:
        step_delta, step_decay = step
        advantage = step_delta + step_decay * advantage
        return advantage, advantage

    _, advantage = lax.scan(back, jnp.zeros_like(last_value), (delta, decay), reverse=True)
    return advantage, advantage + value


def needs_bootstrap(steps: Steps, gae_lambda: float) -> jax.Array:
    """Whether the result of `generalized_advantages` also depends on the values of other steps; `(...)` bool.

    With lambda 1 the values of later steps cancel out. What remains is the value after the last step of an episode that
    the rollout or a truncation cuts short.
    """
    cut = ~steps.terminated[-1] | jnp.any(steps.truncated & ~steps.terminated, axis=0)
    return cut | (gae_lambda < 1.0)


def leave_one_out_baseline(advantage: jax.Array, group: int) -> jax.Array:
    """Subtracts the mean advantage of the other members of the group at the same step.

    A group meets the same demand, so this removes the luck that its members share. The expected gradient is unchanged
    because an environment's baseline contains none of its own actions (leave-one-out baseline, Kool, van Hoof and
    Welling 2019; input-driven baseline, Mao et al. 2018, arXiv:1807.02264).

    Args:
        advantage: `(num_envs, num_steps, ...)`; the members of a group are neighbours.
        group: environments per group; 1 changes nothing.
    """
    if group == 1:
        return advantage
    own = advantage.reshape(-1, group, *advantage.shape[1:])
    others = (jnp.sum(own, axis=1, keepdims=True) - own) / (group - 1)
    return (own - others).reshape(advantage.shape)
