"""What an algorithm is to the runs that train with it: a way to learn, and the policy that comes of it.

One more is a subclass of `TrainConfig` in `train.algorithms.settings.SETTINGS`, an `Algorithm` in
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
    """All that changes in training, enough to go on from; an algorithm adds its own fields in a subclass.

    What belongs to environments, shared out among devices, is `rollout`; the rest is the same on all. With several
    seeds every leaf has a leading axis for them.
    """

    weights: PolicyWeights  # all that acting needs
    rollout: RolloutState  # leaves (num_envs, ...)
    key: jax.Array  # typed PRNG key
    update: jax.Array  # () int32, updates done


class Learner(Protocol):
    """An algorithm at work in one environment, for one seed: pure functions of its state."""

    @property
    def state(self) -> type[TrainState]:
        """The class of its state."""

    @property
    def mesh(self) -> Mesh:
        """Devices that share the environments."""

    def init(self, key: jax.Array, env_params: Any) -> Any:
        """The state before the first update, with the weights of `first_weights` of this key."""

    def update(self, state: Any, env_params: Any) -> tuple[Any, Metrics]:
        """One update.

        Returns:
            The new state, and scalars that describe the update: `reward_mean`, those of
            `train.algorithms.rollout.episode_metrics` and of `train.algorithms.finite.BAD`, and what else there is.
        """


def first_weights(network: nn.Module, key: jax.Array, shape: tuple[int, ...]) -> PolicyWeights:
    """The weights before the first update of a learner that begins with this key; `shape` is an observation's."""
    _, network_key, _ = jax.random.split(
        key, 3
    )  # the others are the environments' and the learner's
    return PolicyWeights(network.init(network_key, jnp.zeros((1, *shape))), init_stats(shape))


@dataclasses.dataclass(frozen=True)
class Algorithm:
    """A way to learn a dispatcher.

    Attributes:
        settings: their class; its `algorithm` is the name in tables and files.
        build_network: `(env, config)` to a network of logits `(..., num_actions)` and values `(...)` at observations
            `(..., num_features)`; of logits the policy takes the highest, or samples their softmax.
        build_learner: `(env, params, config)` to what learns; InputError if `config.num_devices` is not possible.
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
        """What was learned, with the weights of one seed, in a single environment; see `learned_policy`."""
        network = self.build_network(env, config)
        with_rule = dispatched(env, config)
        policy = learned_policy(with_rule or env, network, weights, config.decide_every, stochastic)
        return with_rule.whole(policy) if with_rule else policy

    def weight_shapes(self, env: Environment, params: Any, config: TrainConfig) -> PolicyWeights:
        """Shapes and types of the weights of one seed, found without computing or compiling anything."""
        network = self.build_network(env, config)
        shape = env.observation_space(params).shape
        return jax.eval_shape(lambda key: first_weights(network, key, shape), jax.random.key(0))

    def start(self, env: Environment, config: TrainConfig, weights: PolicyWeights) -> PolicyWeights:
        """The weights of the first seed before any update, made anew as training makes them.

        Args:
            env: a single environment.
            config: settings of the run.
            weights: of the run, with a leading axis if it had several seeds; read for shapes only.
        """
        network = self.build_network(env, config)
        shape = weights.obs_stats.mean.shape[-1:]
        key = jax.random.key(config.seed)
        if config.num_seeds > 1:
            key = jax.random.split(key, config.num_seeds)[0]
        return jax.jit(lambda key: first_weights(network, key, shape))(key)
