"""Metadata of a trained policy: the environment it was trained for, and how."""

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

LEARNED = "ppo"  # default name of a policy


@dataclasses.dataclass(frozen=True)
class About:
    """What a policy was trained for."""

    scenario: str  # empty for a custom environment
    overrides: Mapping[str, Any]  # of `medjax.make`
    observation: str  # its name
    decide_every: int  # decisions from one choice to the next
    num_features: int
    num_actions: int
    name: str = LEARNED  # of the policy
    # Arguments of `medjax.agents.agents_of` if every MED is an agent; else empty.
    agents: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    dispatcher: str = ""  # the rule that dispatches agents, if they do not decide it themselves
    # Settings, versions and other notes of the trainer; informational only.
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def about_of(
    env: Environment, params: Any, decide_every: int, name: str = LEARNED, dispatcher: str = ""
) -> About:
    """Describes an environment from `medjax.make`, so that a policy file can rebuild it.

    Args:
      env, params: as `medjax.make` returned them, without custom parts.
      decide_every, name, dispatcher: as in `About`.

    Raises:
      InputError: the environment has custom parts or changed numbers, which a file cannot describe.
    """
    agents: dict[str, Any] = {}
    highway: Any = env
    if isinstance(env, AgentsEnv):
        central = env.view.road is not None
        agents = {"speeds": env.actions.speeds, "credit": env.credit, "central": central}
        highway = env.env
    recipe = getattr(highway, "recipe", None)  # a custom environment may have none
    allowed = "allowed an environment and its numbers as medjax.make returns them"
    if recipe is None:
        raise InputError(f"a policy file cannot describe {env.name}: {allowed}")
    replaceable = ("reward", "following", "coupling")
    own = [part for part in replaceable if getattr(recipe, part) is not None]
    own += [] if isinstance(recipe.observation, str) else ["observation"]
    if own:
        raise InputError(f"a policy file cannot describe a custom {own[0]}: {allowed}")
    _, given = make(recipe.scenario, observation=recipe.observation, **recipe.overrides)
    here, there = map(jax.tree.leaves, (params, given))
    if len(here) != len(there) or not all(map(np.array_equal, here, there)):
        raise InputError(f"a policy file cannot describe changed numbers of {env.name}: {allowed}")
    return dataclasses.replace(
        about_of_own(env, decide_every, name, dispatcher),
        scenario=recipe.scenario,
        overrides=recipe.overrides,
        observation=recipe.observation,
        agents=agents,
    )


def about_of_own(
    env: Environment, decide_every: int, name: str = LEARNED, dispatcher: str = ""
) -> About:
    """Like `about_of` for a custom environment, which a file cannot rebuild: the user must supply it."""
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
