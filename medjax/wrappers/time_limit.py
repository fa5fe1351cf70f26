"""Time limits that a policy can observe."""

import dataclasses

import jax
import jax.numpy as jnp

from medjax.env.contract import Params, State, StepResult
from medjax.env.wrapper import Wrapper


@dataclasses.dataclass(frozen=True)
class TimeLimitAsEnd(Wrapper):
    """`env` with truncations turned into terminations.

    For a learner whose policy observes the time left: the time limit is then part of the task, and nothing follows it
    (Pardo et al. 2018, arXiv:1712.00378). Cuts by `BatchAutoReset`, which a policy cannot foresee, stay truncations.
    """

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision; truncated is always False."""
        result = self.env.step_env(key, state, action, params)
        obs, state, reward, terminated, truncated, info = result
        return obs, state, reward, terminated | truncated, jnp.zeros_like(truncated), info
