"""What a policy was trained for and how, as its file says it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from medjax.env.agents.environment import AgentsEnv
from medjax.env.contract import Environment
from medjax.errors import InputError
from medjax.scenarios import make

LEARNED = "ppo"  # name of a policy whose file does not say it


@dataclasses.dataclass(frozen=True)
class About:
    """What a policy was trained for."""

    scenario: str  # empty where the environment was somebody's own, which no file can say
    overrides: Mapping[str, Any]  # of `medjax.make`
    observation: str  # name of it
    decide_every: int  # decisions from one choice to the next
    num_features: int
    num_actions: int
    name: str = LEARNED  # of the policy
    # How `medjax.agents.agents_of` was called, where every MED is an agent; else empty.
    agents: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    dispatcher: str = ""  # the rule that sends agents in where they do not
    # How it was trained: settings, versions and whatever else its trainer writes down; for people, nothing reads it.
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def about_of(
    env: Environment, params: Any, decide_every: int, name: str = LEARNED, dispatcher: str = ""
) -> About:
    """What a policy of an environment must know to play in it again.

    Args:
      env: as `medjax.make` built it, with nothing of one's own in it.
      params: those that `medjax.make` gave with it.
      decide_every: decisions from one choice to the next.
      name: of the policy.
      dispatcher: the rule that sends agents in, if one does.

    Raises:
      InputError: an environment that its file could not name.
    """
    agents: dict[str, Any] = {}
    highway: Any = env
    if isinstance(env, AgentsEnv):
        central = env.view.road is not None
        agents = {"speeds": env.actions.speeds, "credit": env.credit, "central": central}
        highway = env.env
    recipe = getattr(highway, "recipe", None)  # an environment of one's own need not have any
    allowed = "allowed: an environment and its numbers as medjax.make gives them"
    if recipe is None:
        raise InputError(f"no file can say what {env.name} is, {allowed}")
    replaceable = ("reward", "following", "coupling")
    own = [part for part in replaceable if getattr(recipe, part) is not None]
    own += [] if isinstance(recipe.observation, str) else ["observation"]
    if own:
        raise InputError(f"no file can say what the {own[0]} of one's own is, {allowed}")
    _, given = make(recipe.scenario, observation=recipe.observation, **recipe.overrides)
    here, there = map(jax.tree.leaves, (params, given))
    if len(here) != len(there) or not all(map(np.array_equal, here, there)):
        raise InputError(f"no file can say which numbers of {env.name} were changed, {allowed}")
    return About(
        scenario=recipe.scenario,
        overrides=recipe.overrides,
        observation=recipe.observation,
        decide_every=decide_every,
        num_features=math.prod(env.observation_space(params).shape),
        num_actions=env.num_actions,
        name=name,
        agents=agents,
        dispatcher=dispatcher,
    )


def about_of_own(
    env: Environment, decide_every: int, name: str = LEARNED, dispatcher: str = ""
) -> About:
    """What `about_of` says, but for what the environment is: only who has it can play the policy."""
    return About(
        scenario="",
        overrides={},
        observation="",
        decide_every=decide_every,
        num_features=math.prod(env.observation_space(None).shape),
        num_actions=env.num_actions,
        name=name,
        dispatcher=dispatcher,
    )
