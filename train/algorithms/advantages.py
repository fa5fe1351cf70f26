"""Generalised advantage estimation with terminations and truncations told apart."""

import jax
import jax.numpy as jnp
from jax import lax


def generalized_advantages(
    reward: jax.Array,
    value: jax.Array,
    last_value: jax.Array,
    terminated: jax.Array,
    truncated: jax.Array,
    final_value: jax.Array,
    *,
    gamma: float,
    gae_lambda: float,
) -> tuple[jax.Array, jax.Array]:
    """GAE(lambda) (Schulman et al. 2016, arXiv:1506.02438, eq. 16) over rollouts with auto-reset.

    After a termination nothing follows. After a truncation the episode would have gone on: its value is that of the
    final observation, and the trace is cut, because the next stored step belongs to another episode. A step that
    both terminates and truncates terminates.

    Args:
        reward: `(num_steps, ...)`.
        value: `(num_steps, ...)`, value of the observation acted on.
        last_value: `(...)`, value of the observation after the last step (of a new episode if that step ended one).
        terminated: `(num_steps, ...)` bool.
        truncated: `(num_steps, ...)` bool.
        final_value: `(num_steps, ...)`, value of the final observation; read only where truncated.
        gamma: discount per step.
        gae_lambda: trace decay per step.

    Returns:
        Advantages and value targets (`advantage + value`), both `(num_steps, ...)`.
    """
    next_value = jnp.concatenate([value[1:], last_value[None]])
    next_value = jnp.where(truncated, final_value, next_value)
    next_value = jnp.where(terminated, 0.0, next_value)
    delta = reward + gamma * next_value - value
    decay = jnp.where(terminated | truncated, 0.0, gamma * gae_lambda)

    def back(
        advantage: jax.Array, step: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        step_delta, step_decay = step
        advantage = step_delta + step_decay * advantage
        return advantage, advantage

    _, advantage = lax.scan(back, jnp.zeros_like(last_value), (delta, decay), reverse=True)
    return advantage, advantage + value
