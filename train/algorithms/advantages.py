"""Generalised advantage estimation with terminations and truncations told apart."""

import jax
import jax.numpy as jnp
from flax import struct
from jax import lax


@struct.dataclass
class Steps:
    """What advantages are made of; every array is `(num_steps, ...)`, or can be broadcast to it."""

    reward: jax.Array
    value: jax.Array  # of the observation acted on
    terminated: jax.Array  # bool
    truncated: jax.Array  # bool
    final_value: jax.Array  # of the final observation; read only where truncated


def generalized_advantages(
    steps: Steps, last_value: jax.Array, *, gamma: float, gae_lambda: float
) -> tuple[jax.Array, jax.Array]:
    """GAE(lambda) (Schulman et al. 2016, arXiv:1506.02438, eq. 16) over rollouts with auto-reset.

    After a termination nothing follows. After a truncation the episode would have gone on: its value is that of the
    final observation, and the trace is cut, because the next stored step belongs to another episode. A step that
    both terminates and truncates terminates.

    Args:
        steps: of the rollouts.
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

    def back(
        advantage: jax.Array, step: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        step_delta, step_decay = step
        advantage = step_delta + step_decay * advantage
        return advantage, advantage

    _, advantage = lax.scan(back, jnp.zeros_like(last_value), (delta, decay), reverse=True)
    return advantage, advantage + value


def asks_everywhere(steps: Steps, gae_lambda: float) -> jax.Array:
    """Whether the advantages of rollouts depend on more values than that of the step they are of; `(...)` bool.

    With lambda 1 all others cancel out, but for those that stand for what comes after a cut. Of what
    `generalized_advantages` returns: `less_others` goes on to read the others' values at the same step.
    """
    cut = ~steps.terminated[-1] | jnp.any(steps.truncated & ~steps.terminated, axis=0)
    return cut | (gae_lambda < 1.0)


def less_others(advantage: jax.Array, group: int) -> jax.Array:
    """Advantages less the mean of those of the group's others at the same step.

    What the others met, too, is no merit of an action: where a group meets the same demand, this takes out its luck,
    and leaves the expected gradient as it is, since no action of one's own is in it (leave-one-out baseline, Kool, van
    Hoof and Welling 2019; input-driven baseline, Mao et al. 2018, arXiv:1807.02264).

    Args:
        advantage: `(num_envs, num_steps, ...)`, neighbours in groups.
        group: environments in each; 1 leaves all as it is.
    """
    if group == 1:
        return advantage
    own = advantage.reshape(-1, group, *advantage.shape[1:])
    others = (jnp.sum(own, axis=1, keepdims=True) - own) / (group - 1)
    return (own - others).reshape(advantage.shape)
