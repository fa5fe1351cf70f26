"""The interface between algorithms and training runs: how to learn, and the policy that results.

A new algorithm needs a subclass of `TrainConfig` in `train.algorithms.settings.SETTINGS`, an `Algorithm` in
`train.algorithms.registry.ALGORITHMS`, and a command like `train.ppo`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh

from medjax.env.contract import Environment
from medjax.policies.policy import Policy
from train.algorithms.environments import dispatched
from train.algorithms.networks import PolicyWeights, learned_policy
from train.algorithms.normalization import init_stats
from train.algorithms.rollout import RolloutState
from train.settings import TrainConfig

Metrics = dict[str, jax.Array]


@struct.dataclass
class TrainState:
    """Everything that changes during training, enough to resume from; an algorithm adds fields in a subclass.

    `rollout` belongs to the environments and is sharded across devices; the rest is replicated. With several seeds
    every leaf has a leading axis for them.
    """

    weights: PolicyWeights  # what acting needs
    rollout: RolloutState  # leaves (num_envs, ...)
    key: jax.Array  # typed PRNG key
    update: jax.Array  # () int32, updates done


class Learner(Protocol):
    """An algorithm in one environment, for one seed: pure functions of the training state."""

    @property
    def state(self) -> type[TrainState]:
        """Class of the training state."""

    @property
    def mesh(self) -> Mesh:
        """The devices that share the environments."""

    def init(self, key: jax.Array, env_params: Any) -> Any:
        """The state before the first update; its weights are `first_weights` of this key."""

    def update(self, state: Any, env_params: Any) -> tuple[Any, Metrics]:
        """One update.

        Returns:
            The new state, and scalars that describe the update: `reward_mean`,
            `train.algorithms.rollout.episode_metrics`, `train.algorithms.finite.BAD`, and any of the algorithm's own.
        """


def first_weights(network: nn.Module, key: jax.Array, shape: tuple[int, ...]) -> PolicyWeights:
    """Initial weights of a learner that starts from this key; `shape` is that of an observation."""
    # The other two keys belong to the environments and to the learner.
    _, network_key, _ = jax.random.split(key, 3)
    params = network.init(network_key, jnp.zeros((1, *shape)))
    return PolicyWeights(params, init_stats(shape), jnp.float32(1.0))


@dataclasses.dataclass(frozen=True)
class Algorithm:
    """An algorithm that learns a dispatcher.

    Attributes:
        settings: class of its settings; their `algorithm` is its name in tables and files.
        build_network: `(env, config)` to a network that maps observations `(..., num_features)` to logits
            `(..., num_actions)` and values `(...)`. The policy takes the highest logit, or samples their softmax.
        build_learner: `(env, params, config)` to a `Learner`; InputError if `config.num_devices` is not possible.
    """

    settings: type[TrainConfig]
    build_network: Callable[[Environment, Any], nn.Module]
    build_learner: Callable[[Environment, Any, Any], Learner]

    def policy(
        self,
        env: Environment,
        config: TrainConfig,
        weights: PolicyWeights,
        stochastic: bool = False,
    ) -> Policy:
        """The policy that one seed learned, in a single environment; see `learned_policy`."""
        network = self.build_network(env, config)
        with_rule = dispatched(env, config)
        policy = learned_policy(with_rule or env, network, weights, config.decide_every, stochastic)
        return with_rule.whole(policy) if with_rule else policy

    def weight_shapes(self, env: Environment, params: Any, config: TrainConfig) -> PolicyWeights:
        """Shapes and types of one seed's weights, without computing or compiling anything."""
        network = self.build_network(env, config)
        shape = env.observation_space(params).shape
        return jax.eval_shape(lambda key: first_weights(network, key, shape), jax.random.key(0))

    def start(self, env: Environment, config: TrainConfig, weights: PolicyWeights) -> PolicyWeights:
        """The first seed's initial weights, recreated the way training creates them.

        Args:
            env: a single environment.
            config: settings of the run.
            weights: the run's weights; only the number of features is read, the last axis of the moments.
        """
        network = self.build_network(env, config)
        shape = weights.obs_stats.mean.shape[-1:]
        key = jax.random.key(config.seed)
        if config.num_seeds > 1:
            key = jax.random.split(key, config.num_seeds)[0]
        return jax.jit(lambda key: first_weights(network, key, shape))(key)
