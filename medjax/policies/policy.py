"""What a dispatcher is: the one protocol of rules, learned policies and those read from a file."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct


class Choice(NamedTuple):
    """What a policy does at a decision."""

    action: jax.Array  # () int32; of agents (A,), one each
    probabilities: jax.Array  # (..., num_actions) that it was drawn with; of a rule 0 and 1


# Equal to itself alone: `jax.jit(policy)` needs a hash, and weights have none.
class Policy(struct.PyTreeNode, eq=False):
    """A way to act in one environment, for `jax.vmap` and `jax.jit` over whatever is batched.

    `policy(key, obs, state, params)` is what it does in one state of the environment that it was built for. A policy is
    a pytree of its weights: handed to a compiled program it is an argument of it, and other weights are not compiled
    anew.
    """

    act: Callable[[Any, jax.Array, Any, Any, Any], Choice] = struct.field(pytree_node=False)
    weights: Any = ()  # arrays, the first argument of `act`; a rule has none
    # From the environment's numbers to those that it plays in: a control may have drivers do what others do by MEDs.
    world: Callable[[Any], Any] = struct.field(pytree_node=False, default=lambda params: params)

    def __repr__(self) -> str:
        numbers = sum(jnp.size(leaf) for leaf in jax.tree.leaves(self.weights))
        return f"<policy with {numbers:,} weights>"

    def __call__(self, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """What it does; `key` is the randomness of this decision, `obs` as the environment returned it."""
        return self.act(self.weights, key, obs, state, params)


def rule(act: Callable[[jax.Array, Any, Any], jax.Array], num_actions: int) -> Policy:
    """A policy without weights; `act(key, state, params)` gives an action, () int32, that is allowed."""

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        action = act(key, state, params)
        return Choice(action, jax.nn.one_hot(action, num_actions, dtype=jnp.float32))

    return Policy(choose)


def every(policy: Policy, interval: int) -> Policy:
    """`policy` asked at every `interval`-th decision of an episode; action 0 in between (`wrappers.DecideEvery`)."""
    if interval == 1:
        return policy

    def choose(weights: Any, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        asked = state.time % interval == 0
        choice = policy.act(weights, key, obs, state, params)
        nothing = jnp.zeros_like(choice.action)
        num_actions = choice.probabilities.shape[-1]
        wait = Choice(nothing, jax.nn.one_hot(nothing, num_actions, dtype=jnp.float32))
        return jax.tree.map(lambda now, later: jnp.where(asked, now, later), choice, wait)

    return Policy(choose, policy.weights, policy.world)
