"""The five-value step of gymnax before 1.0, for code that was written for it, as PureJaxRL was."""

import dataclasses
from typing import Any

import jax

from medjax.env.charging_env import ChargingEnv
from medjax.env.contract import Info, Observation, Params, State
from medjax.env.spaces import Discrete
from medjax.wrappers.base import Wrapper


@dataclasses.dataclass(frozen=True)
class LegacyStep(Wrapper):
    """`env` whose step returns one flag, `done`, for an episode that terminated or was truncated.

    What is lost: an episode of medjax ends by its time limit, and code that reads `done` takes the value of what comes
    after it for 0, as if the road were empty then. That is right for a dispatcher that sees the time left, as both
    observations of medjax show it (Pardo et al. 2018, arXiv:1712.00378, "time awareness"), and biased for one that
    does not, or whose road goes on. To bootstrap all the same: `info["terminated"]` and `info["truncated"]` tell the
    two ends apart, and `info["final_observation"]` is what the ended episode led to, where `done`; the observation
    returned is then the first of the next episode.

    Attributes:
        env: a single environment.
    """

    env: ChargingEnv

    def action_space(self, params: Params = None) -> Discrete:
        """That of the environment."""
        return self.env.action_space(params)

    def step(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> tuple[Observation, State, jax.Array, jax.Array, Info]:
        """One decision, and a reset in the same step when the episode ends.

        Returns:
            (observation (size,) float32, state, reward () float32, done () bool, info); see `ChargingEnv.step`.
        """
        obs, state, reward, terminated, truncated, info = self.env.step(key, state, action, params)
        ends: dict[str, Any] = {"terminated": terminated, "truncated": truncated}
        return obs, state, reward, terminated | truncated, {**info, **ends}
