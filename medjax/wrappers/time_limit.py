"""Time limits that a policy sees coming."""

import dataclasses

import jax
import jax.numpy as jnp

from medjax.env.contract import Params, State, StepResult
from medjax.env.wrapper import Wrapper


@dataclasses.dataclass(frozen=True)
class TimeLimitAsEnd(Wrapper):
    """`env` whose episodes terminate where it truncates them.

    For a learner whose policy sees the time left: nothing that it could do comes after the time limit, which is then
    a part of its task (Pardo et al. 2018, arXiv:1712.00378). Cuts by `BatchAutoReset`, which nobody sees coming, stay
    truncations.
    """

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision; truncated is always False."""
        result = self.env.step_env(key, state, action, params)
        obs, state, reward, terminated, truncated, info = result
        return obs, state, reward, terminated | truncated, jnp.zeros_like(truncated), info
