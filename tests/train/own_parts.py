"""What somebody brings to the commands: a term of the reward, and a wrapper."""

import dataclasses

from tests.train.probe_envs import Probe


def served(outcome):
    """EVs that began to charge for the first time."""
    return outcome.step_stats.evs_served


def generous(env):
    """A probe that pays 10 more a step."""
    return Generous(env.kind, observation=env.observation)


@dataclasses.dataclass(frozen=True)
class Generous(Probe):
    """A probe of somebody's own, which no file can name."""

    def step_env(self, key, state, action, params):
        obs, state, reward, *rest = super().step_env(key, state, action, params)
        return obs, state, reward + 10.0 * params.reward, *rest
