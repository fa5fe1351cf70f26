"""Dispatchers among agents: a policy for those at the heads of the depots' lines, whatever the others do."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.agents.environment import AgentsEnv
from medjax.env.contract import Params, State, StepResult
from medjax.env.depots import who_is_sent
from medjax.env.wrapper import Wrapper
from medjax.policies.policy import Choice, Policy
from medjax.policies.rules import BASELINES


def of_head(
    env: AgentsEnv, dispatcher: Policy, key: jax.Array, state: Any, params: Any
) -> jax.Array:
    """The actions of all agents, `(A,)` int32, when `dispatcher`, of the highway `env.env`, sends them in."""
    choice = dispatcher(key, env.env.get_obs(state, params), state, params)
    sent = who_is_sent(choice.action, state.meds, env.env.config)
    return jnp.where(sent, choice.action, 0).astype(jnp.int32)


def as_team(env: AgentsEnv, dispatcher: Policy) -> Policy:
    """`dispatcher`, of the highway `env.env`, as a policy of all agents."""

    def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """See `of_head`."""
        own = Policy(dispatcher.act, weights)
        action = of_head(env, own, key, state, params)
        return Choice(action, jax.nn.one_hot(action, env.num_actions, dtype=jnp.float32))

    return Policy(act, dispatcher.weights, dispatcher.world)


@dataclasses.dataclass(frozen=True)
class Dispatched(Wrapper):
    """`env`, whose agents are sent in by a dispatcher; at the depot they have no choice.

    Attributes:
        env: of agents.
        dispatcher: of the highway under it, `env.env`; without a draw of its own.
    """

    env: AgentsEnv
    dispatcher: Policy

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision."""
        sent = of_head(self.env, self.dispatcher, jax.random.key(0), state, params)
        return self.env.step_env(key, state, jnp.where(sent > 0, sent, action), params)

    def whole(self, policy: Policy) -> Policy:
        """A policy of `env` that does the same: moves as `policy`, of this environment, and sends as the dispatcher."""

        def act(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
            """What `policy` does, but where the dispatcher sends."""
            choice = policy.act(weights, key, obs, state, params)
            sent = of_head(self.env, self.dispatcher, key, state, params)
            certain = jax.nn.one_hot(sent, self.num_actions, dtype=jnp.float32)
            return Choice(
                jnp.where(sent > 0, sent, choice.action),
                jnp.where(sent[:, None] > 0, certain, choice.probabilities),
            )

        return Policy(act, policy.weights, policy.world)

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """Of those at the depot action 0 alone."""
        enters = slice(1, 1 + self.env.config.num_ramps)
        return self.env.action_mask(state, params).at[:, enters].set(False)


def rules_of(env: Any) -> dict[str, Policy]:
    """Every rule of `medjax.policies.rules` by name, for an environment of a dispatcher or of agents.

    Rules play the highway: where there is none, there are none of them.
    """
    if not hasattr(env, "highway"):
        return {}
    if not isinstance(env, AgentsEnv):
        return {name: build(env) for name, build in BASELINES.items()}
    return {name: as_team(env, build(env.env)) for name, build in BASELINES.items()}
