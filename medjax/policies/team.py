"""Dispatchers for multi-agent environments: they decide for the first MED waiting at each depot."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.agents.environment import AgentsEnv
from medjax.env.contract import Params, State, StepResult
from medjax.env.depots import med_to_send
from medjax.env.dispatch import is_allowed
from medjax.env.wrapper import Wrapper
from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES

INVALID = -1  # an action that no environment allows


def of_head(
    env: AgentsEnv, dispatcher: Policy, key: jax.Array, state: Any, params: Any
) -> jax.Array:
    """Actions of all agents, `(A,)` int32, if `dispatcher`, a policy of the highway `env.env`, sends them."""
    choice = dispatcher(key, env.env.get_obs(state, params), state, params)
    sent = med_to_send(choice.action, state.meds, env.env.config)
    return jnp.where(sent, choice.action, 0).astype(jnp.int32)


def as_team(env: AgentsEnv, dispatcher: Policy) -> Policy:
    """Turns `dispatcher`, a policy of the highway `env.env`, into a policy of all agents."""

    def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """See `of_head`."""
        own = Policy(dispatcher.act, weights)
        action = of_head(env, own, key, state, params)
        return Choice(action, jax.nn.one_hot(action, env.num_actions, dtype=jnp.float32))

    return Policy(act, dispatcher.weights, dispatcher.params_transform)


@dataclasses.dataclass(frozen=True)
class Dispatched(Wrapper):
    """`env` with a dispatcher that sends the agents; at a depot, they have no choice.

    Attributes:
        env: multi-agent environment.
        dispatcher: policy of the highway `env.env`; must be deterministic.
    """

    env: AgentsEnv
    dispatcher: Policy

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision; an agent at a depot that would enter by itself makes an invalid choice, as in `AgentsEnv`."""
        sent = of_head(self.env, self.dispatcher, jax.random.key(0), state, params)
        own = jnp.where(is_allowed(action, self.action_mask(state, params)), action, INVALID)
        action = jnp.where(sent > 0, sent, own)
        obs, after, *ends, info = self.env.step_env(key, state, action, params)
        return obs, after, *ends, info | {"action_mask": self.action_mask(after, params)}

    def whole(self, policy: Policy) -> Policy:
        """Combines `policy`, of this environment, and the dispatcher into one policy of `env`."""

        def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
            """Acts as `policy`, except for an agent that the dispatcher sends."""
            choice = policy.act(weights, key, obs, state, params)
            sent = of_head(self.env, self.dispatcher, key, state, params)
            certain = jax.nn.one_hot(sent, self.num_actions, dtype=jnp.float32)
            return Choice(
                jnp.where(sent > 0, sent, choice.action),
                jnp.where(sent[:, None] > 0, certain, choice.probabilities),
            )

        return Policy(act, policy.weights, policy.params_transform)

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """Allowed actions without dispatching: an agent at a depot may only take action 0."""
        enters = slice(1, 1 + self.env.config.num_ramps)
        return self.env.action_mask(state, params).at[:, enters].set(False)


def rules_of(env: Any) -> dict[str, Policy]:
    """All rules of `medjax.policies.rules` by name, for a single-dispatcher or multi-agent environment.

    Empty if the environment has no highway.
    """
    if not hasattr(env, "highway"):
        return {}
    if not isinstance(env, AgentsEnv):
        return {name: build(env) for name, build in BASELINES.items()}
    return {name: as_team(env, build(env.env)) for name, build in BASELINES.items()}
