"""The policy protocol, shared by rules, learned policies and policies read from files."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct


class Choice(NamedTuple):
    """A policy's action at one decision, and the distribution behind it."""

    action: jax.Array  # () int32; (A,) for agents, one each
    probabilities: jax.Array  # (..., num_actions) of the actions; 0 and 1 for a rule


# Compared by identity, because `jax.jit(policy)` needs a hash and weights have none.
class Policy(struct.PyTreeNode, eq=False):
    """A way to act in one environment, compatible with `jax.jit` and `jax.vmap`.

    `policy(key, obs, state, params)` chooses in one state of the environment that it was built for. A policy is a
    pytree of its weights: as an argument of a compiled program, it can change its weights without recompilation.
    """

    act: Callable[[Any, jax.Array, Any, Any, Any], Choice] = struct.field(pytree_node=False)
    weights: Any = ()  # arrays, the first argument of `act`; most rules have none
    # Maps the environment's params to those that the policy plays in; a control such as `slow` changes the drivers.
    params_transform: Callable[[Any], Any] = struct.field(
        pytree_node=False, default=lambda params: params
    )

    def __repr__(self) -> str:
        numbers = sum(jnp.size(leaf) for leaf in jax.tree.leaves(self.weights))
        return f"<policy with {numbers:,} weights>"

    def __call__(self, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """Chooses; `key` is the randomness of this decision, `obs` the environment's observation."""
        return self.act(self.weights, key, obs, state, params)


def rule(act: Callable[[jax.Array, Any, Any], jax.Array], num_actions: int) -> Policy:
    """A policy without weights; `act(key, state, params)` returns an allowed action, () int32."""

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        action = act(key, state, params)
        return Choice(action, jax.nn.one_hot(action, num_actions, dtype=jnp.float32))

    return Policy(choose)


def sampled(policy: Policy) -> Policy:
    """The policy that draws each action from the probabilities of another, which a rule's 0 and 1 leave as it is."""

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        act_key, draw_key = jax.random.split(key)
        _, probabilities = policy.act(weights, act_key, obs, state, params)
        action = jax.random.categorical(draw_key, jnp.log(probabilities))
        return Choice(action.astype(jnp.int32), probabilities)

    return Policy(choose, policy.weights, policy.params_transform)


def every(policy: Policy, interval: int) -> Policy:
    """Asks `policy` at every `interval`-th decision; takes action 0 in between (see `wrappers.DecideEvery`)."""
    if interval == 1:
        return policy

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        asked = state.time % interval == 0
        choice = policy.act(weights, key, obs, state, params)
        nothing = jnp.zeros_like(choice.action)
        num_actions = choice.probabilities.shape[-1]
        wait = Choice(nothing, jax.nn.one_hot(nothing, num_actions, dtype=jnp.float32))
        return jax.tree.map(lambda now, later: jnp.where(asked, now, later), choice, wait)

    return Policy(choose, policy.weights, policy.params_transform)
