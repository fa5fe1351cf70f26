"""The five-value step of gymnax before 1.0, for code that was written for it, as PureJaxRL was."""

import dataclasses

import jax

from medjax.env.contract import Info, Observation, Params, State
from medjax.env.wrapper import Wrapper


@dataclasses.dataclass(frozen=True)
class LegacyStep(Wrapper):
    """`env` whose step returns one flag, `done`, for an episode that terminated or was truncated.

    What is lost: an episode of medjax ends by its time limit, and code that reads `done` takes the value of what comes
    after it for 0, as if the road were empty then. That is right for a dispatcher that sees the time left, as both
    observations of medjax show it (Pardo et al. 2018, arXiv:1712.00378, "time awareness"), and biased for one that
    does not, or whose road goes on. To bootstrap all the same: `info["terminated"]` and `info["truncated"]` tell the
    two ends apart, and `info["final_observation"]` is what the ended episode led to, where `done`; the observation
    returned is then the first of the next episode.

    To be put around all other wrappers, which hand on the raw step only.
    """

    def step(  # type: ignore[override]
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> tuple[Observation, State, jax.Array, jax.Array, Info]:
        """One decision, and a reset in the same step when the episode ends.

        Returns:
            (observation (size,) float32, state, reward () float32, done () bool, info); see `step_with_reset`.
        """
        obs, state, reward, terminated, truncated, info = self.env.step(key, state, action, params)
        info = {**info, "terminated": terminated, "truncated": truncated}
        return obs, state, reward, terminated | truncated, info
