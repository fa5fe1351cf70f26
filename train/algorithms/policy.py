"""A network and its weights as a policy of `medjax.policies`."""

from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from medjax.env.contract import Environment
from medjax.policies.policy import Choice, Policy, every
from train.algorithms.networks import PolicyWeights, apply_policy


def learned_policy(
    env: Environment,
    network: nn.Module,
    weights: PolicyWeights,
    decide_every: int = 1,
    stochastic: bool = False,
) -> Policy:
    """The most probable action of a network, or a sample.

    Args:
        env: a single environment.
        network: an actor-critic, see `train.algorithms.networks`.
        weights: what it learned.
        decide_every: decisions from one choice to the next, see `medjax.wrappers.DecideEvery`.
        stochastic: sample.
    """

    def act(given: PolicyWeights, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        distribution, _ = apply_policy(network, given, obs, env.action_mask(state, params))
        action = distribution.sample(seed=key) if stochastic else distribution.mode()
        return Choice(action.astype(jnp.int32), distribution.probs)

    return every(Policy(act, weights), decide_every)
