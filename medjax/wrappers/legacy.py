"""The five-value step of gymnax before 1.0, for code written for it, such as PureJaxRL."""

import dataclasses

import jax

from medjax.env.contract import Info, Observation, Params, State
from medjax.env.wrapper import Wrapper


@dataclasses.dataclass(frozen=True)
class LegacyStep(Wrapper):
    """`env` whose step returns one flag, `done`, for both termination and truncation.

    Episodes of medjax end by a time limit, after which code that reads only `done` assumes a value of 0. That is
    correct for a policy that observes the time left, as both observations of medjax provide (Pardo et al. 2018,
    arXiv:1712.00378, "time awareness"), and biased otherwise. To bootstrap anyway, use `info["terminated"]` and
    `info["truncated"]` to tell the two apart, and `info["final_observation"]` where `done`; the returned observation is
    then the first of the next episode.

    Apply it after all other wrappers, because they do not forward this `step`.
    """

    def step(  # type: ignore[override]
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> tuple[Observation, State, jax.Array, jax.Array, Info]:
        """Takes one decision and resets in the same step when the episode ends.

        Returns:
            (observation (size,) float32, state, reward () float32, done () bool, info); see `step_with_reset`.
        """
        obs, state, reward, terminated, truncated, info = self.env.step(key, state, action, params)
        info = {**info, "terminated": terminated, "truncated": truncated}
        return obs, state, reward, terminated | truncated, info
