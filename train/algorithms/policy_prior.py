"""The policy prior: the logits that a network adds to, and so the policy that training starts from.

`TrainConfig.policy_prior` names it.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.agents.view import AgentView
from medjax.env.observation import RoadProfile
from medjax.policies.rules import tuned_budget
from medjax.world.state import IN_SERVICE, MERGING, QUEUED
from train.settings import TrainConfig

GOES_ON = 0.99  # initial probability that an agent stays, rather than leaves the road for good
# Of the fleet's speed, where the others have 0: an agent tries all speeds, and its most probable action is the rule's.
USUAL_SPEED_LOGIT = 0.1
MASKED_LOGIT = -1e9  # finite to keep log-probabilities and gradients finite; its exp() is exactly 0

Prior = Callable[[jax.Array], jax.Array]  # observations `(..., num_features)` to logits


def prior_logits(env: Any, config: TrainConfig) -> Prior:
    """The prior of a dispatcher, `(..., num_actions)` logits, or of agents, `(..., num_logits)`.

    At the depot an agent starts like a dispatcher. In service it most likely does what the rule does, but tries all
    speeds.
    """
    dispatches = _of_dispatcher(env, config)
    if not isinstance(env.observation, AgentView):
        return dispatches
    likely, usual = config.initial_wait, env.actions.usual
    _, speed, lane, accept, leave = env.actions.parts
    motion = jnp.concatenate(
        [
            jnp.zeros((speed.n,), jnp.float32).at[usual[0]].set(USUAL_SPEED_LOGIT),
            _mostly(usual[1], lane.n, likely),
            _mostly(1, accept.n, likely),
            _mostly(0, leave.n, GOES_ON),
        ]
    )

    def of_agents(obs: jax.Array) -> jax.Array:
        # A MED that was sent chooses every part itself, so "do as the rule does" is masked, too.
        sent = obs[..., QUEUED, None] + obs[..., MERGING, None] + obs[..., IN_SERVICE, None]
        at_depot = jnp.where(sent > 0.5, MASKED_LOGIT, dispatches(obs))
        of_parts = jnp.broadcast_to(motion, (*obs.shape[:-1], motion.shape[0]))
        return jnp.concatenate([at_depot, of_parts], axis=-1)

    return of_agents


def tells_ramps(env: Any) -> bool:
    """Whether a dispatcher's actions are the ramps, and its observation tells what is to be known of each."""
    ramps = env.num_actions - 1  # a wrapper may have added or removed actions
    return isinstance(env.observation, RoadProfile) and 0 < ramps == env.config.num_ramps


def starts_from_rule(env: Any, config: TrainConfig) -> bool:
    """Whether the first policy is that of the rule: the setting says so, and observations tell what the rule reads."""
    of_agents = isinstance(env.observation, AgentView) and env.config.num_ramps > 0
    return config.policy_prior == "rule" and (tells_ramps(env) or of_agents)


def _of_dispatcher(env: Any, config: TrainConfig) -> Prior:
    """Follows the rule where the policy starts from it; else mostly waits."""
    layout = env.observation
    ramps = env.config.num_ramps if isinstance(layout, AgentView) else env.num_actions - 1
    if starts_from_rule(env, config):
        env_config, budget = env.config, tuned_budget(env)

        def like_rule(obs: jax.Array) -> jax.Array:
            margin = budget.margin(*layout.outlook(obs, env_config))
            return jnp.pad(config.rule_sharpness * margin, [(0, 0)] * (obs.ndim - 1) + [(1, 0)])

        return like_rule
    logits = _mostly(0, 1 + ramps, config.initial_wait)
    return lambda obs: jnp.broadcast_to(logits, (*obs.shape[:-1], 1 + ramps))


def _mostly(usual: int, choices: int, probability: float) -> jax.Array:
    """Logits `(choices,)` that give one choice this probability and share the rest equally."""
    odds = math.log(probability / (1.0 - probability) * max(choices - 1, 1))
    return jnp.zeros((choices,), jnp.float32).at[usual].set(odds)
