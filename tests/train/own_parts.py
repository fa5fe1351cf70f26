"""A custom reward term and a custom wrapper."""

import dataclasses

from tests.train.probe_envs import Probe


def served(outcome):
    """EVs that began to charge for the first time."""
    return outcome.step_stats.evs_served


def soc(outcome):
    """Has the name of a term of the preset."""
    return outcome.step_stats.evs_served


def generous(env):
    """A probe that pays 10 more a step."""
    return Generous(env.kind, observation=env.observation)


@dataclasses.dataclass(frozen=True)
class Generous(Probe):
    """A custom probe, which no file can describe."""

    def step_env(self, key, state, action, params):
        obs, state, reward, *rest = super().step_env(key, state, action, params)
        return obs, state, reward + 10.0 * params.reward, *rest
