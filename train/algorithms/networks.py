"""Actor-critic networks and the masked policy distribution.

A network maps normalised observations `(..., num_features)` to action logits `(..., num_actions)` and values `(...)`,
both float32 whatever type it computes in. `NETWORKS` lists the builders; each entry is a choice of `--network`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from distrax import Categorical  # the only import of distrax; other modules import it from here
from flax import struct

from medjax.env.agents.view import AgentView
from medjax.env.contract import Environment
from medjax.env.observation import FlatObservation
from medjax.errors import InputError, shown
from medjax.policies.policy import Choice, Policy, every
from medjax.world.params import EnvConfig
from train.algorithms.normalization import RunningStats, normalize
from train.algorithms.policy_prior import MASKED_LOGIT, prior_logits, tells_ramps
from train.settings import TrainConfig

TYPICAL_NUMBER = 8.0  # vehicles in a set
RAMP_LAYERS = (32, 32)  # widths of the network that ramps share

ACTIVATIONS = {"tanh": nn.tanh, "relu": nn.relu, "silu": nn.silu}
DTYPES = {"float32": jnp.float32, "bfloat16": jnp.bfloat16}


@struct.dataclass
class PolicyWeights:
    """Everything that acting needs: a trained policy."""

    params: Any  # of the network
    obs_stats: RunningStats  # moments that normalise observations
    # () factor of the logits, which an algorithm may let grow during training
    sharpness: jax.Array | float = 1.0


class Torso(nn.Module):
    """Fully connected layers."""

    hidden: Sequence[int]
    activation: Callable[[jax.Array], jax.Array]
    dtype: Any

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """`(..., num_features)` to `(..., hidden[-1])`."""
        for width in self.hidden:
            init = nn.initializers.orthogonal(jnp.sqrt(2.0))
            x = self.activation(nn.Dense(width, kernel_init=init, dtype=self.dtype)(x))
        return x


class SetTorso(nn.Module):
    """MEDs and EVs of a flat observation as sets (Deep Sets, Zaheer et al. 2017, arXiv:1703.06114): no order matters.

    One encoder per kind encodes each vehicle. The codes are summed over the vehicles present; the sums and the clock go
    through fully connected layers. A row of zeros is an empty slot.
    """

    layout: FlatObservation
    env_config: EnvConfig
    encoder: Sequence[int]
    hidden: Sequence[int]
    activation: Callable[[jax.Array], jax.Array]
    dtype: Any

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """`(..., num_features)` to `(..., hidden[-1])`."""
        *sets, clock = self.layout.split(x, self.env_config)
        sums = [clock]
        for rows in sets:
            there = jnp.any(rows != 0.0, axis=-1, keepdims=True)
            codes = Torso(self.encoder, self.activation, self.dtype)(rows)
            # A set has about a dozen vehicles: divided, the sums have the scale that the next layer expects.
            sums.append(jnp.sum(jnp.where(there, codes, 0.0), axis=-2) / TYPICAL_NUMBER)
        return Torso(self.hidden, self.activation, self.dtype)(jnp.concatenate(sums, axis=-1))


class ActorCritic(nn.Module):
    """Separate actor and critic networks, so that the value's gradients do not disturb the policy.

    Where the observation tells the ramps apart, a small network that all ramps share adds to the logit of sending from
    each: what is learned at one ramp holds at all.

    Initialisation is orthogonal. The actor's last layers start near zero (0.01), so that the initial policy is close to
    the prior (Andrychowicz et al. 2021, arXiv:2006.05990, section 3.2; residual policy learning, Silver et al. 2018,
    arXiv:1812.06298).
    """

    num_logits: int
    make_torso: Callable[[], nn.Module]  # all layers but the last
    prior: Callable[[jax.Array], jax.Array]  # observations to the logits that learning adds to
    fold: Callable[[jax.Array], jax.Array]  # `(..., num_logits)` to logits of the actions
    acts_on: int  # leading features that the actor sees; the critic sees all
    # Observations to features of each ramp, `(..., num_ramps, n)`; None: there is no network of ramps.
    of_ramps: Callable[[jax.Array], jax.Array] | None = None

    def setup(self) -> None:
        """Makes the layers."""
        self.actor = self.make_torso()
        self.critic = self.make_torso()
        small, unit = nn.initializers.orthogonal(0.01), nn.initializers.orthogonal(1.0)
        self.logits_head = nn.Dense(self.num_logits, kernel_init=small, dtype=jnp.float32)
        if self.of_ramps is not None:
            self.ramp_torso = Torso(RAMP_LAYERS, nn.silu, jnp.float32)
            self.ramp_head = nn.Dense(1, kernel_init=small, dtype=jnp.float32)
        self.value_head = nn.Dense(1, kernel_init=unit, dtype=jnp.float32)

    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """`(..., num_features)` to logits `(..., num_actions)` and values `(...)`."""
        acted_on = obs[..., : self.acts_on]
        logits = self.prior(obs) + self.logits_head(self.actor(acted_on).astype(jnp.float32))
        if self.of_ramps is not None:
            sends = self.ramp_head(self.ramp_torso(self.of_ramps(obs)))[..., 0]
            logits += jnp.pad(sends, [(0, 0)] * (obs.ndim - 1) + [(1, 0)])
        value = self.value_head(self.critic(obs).astype(jnp.float32))
        return self.fold(logits), value[..., 0]


def mlp(env: Environment, config: TrainConfig) -> Callable[[], nn.Module]:
    """Fully connected layers for any observation."""
    return partial(Torso, *_layers(config))


def sets(env: Environment, config: TrainConfig) -> Callable[[], nn.Module]:
    """`SetTorso` for the paper's flat observation; `check_network` refuses others."""
    return partial(SetTorso, env.observation, env.config, config.encoder, *_layers(config))


def _layers(config: TrainConfig) -> tuple[Any, ...]:
    """Widths, activation and type of the hidden layers."""
    return config.hidden, ACTIVATIONS[config.activation], DTYPES[config.compute_dtype]


RAMPS = "ramps"
NETWORKS = {RAMPS: mlp, "mlp": mlp, "sets": sets}


def check_network(config: TrainConfig, layout: Any) -> None:
    """Refuses (InputError) an unknown network, or one that does not fit the observation `layout`."""
    if config.network not in NETWORKS:
        raise InputError(f"network is {shown(config.network)}, allowed: {', '.join(NETWORKS)}")
    if config.network == "sets" and not isinstance(layout, FlatObservation):
        given = shown(config.observation)
        raise InputError(f"network is 'sets' and observation is {given}, allowed: flat")


def build_network(env: Environment, config: TrainConfig) -> nn.Module:
    """The actor-critic that `config.network` names.

    Args:
        env: environment to act in; only its numbers of actions and vehicles are read.
        config: settings, completed by `TrainConfig.for_episodes`.

    Raises:
        InputError: an unknown network, or one that does not fit the observation.
    """
    check_network(config, env.observation)
    make_torso, prior = NETWORKS[config.network](env, config), prior_logits(env, config)
    if isinstance(env.observation, AgentView):
        agents: Any = env
        actions, seen = agents.actions, env.observation.own_size(env.config)
        return ActorCritic(actions.num_logits, make_torso, prior, actions.fold_logits, seen)
    (size,) = env.observation_space(None).shape
    layout, of_ramps = env.observation, None
    if config.network == RAMPS and tells_ramps(env):
        of_ramps = partial(layout.of_ramps, config=env.config)
    return ActorCritic(env.num_actions, make_torso, prior, lambda logits: logits, size, of_ramps)


def masked_categorical(logits: jax.Array, mask: jax.Array) -> Categorical:
    """Distribution over the allowed actions.

    Args:
        logits: `(..., num_actions)` float32.
        mask: `(..., num_actions)` bool, True = allowed; at least one per entry.

    Returns:
        A categorical distribution in which masked actions have probability exactly 0 and add nothing to the entropy.
    """
    return Categorical(logits=jnp.where(mask, logits, MASKED_LOGIT), dtype=jnp.int32)


def apply_policy(
    network: nn.Module, weights: PolicyWeights, obs: jax.Array, mask: jax.Array
) -> tuple[Categorical, jax.Array]:
    """Policy and value at raw observations.

    Args:
        network: the network.
        weights: parameters, the moments that normalise observations, and the factor of the logits.
        obs: `(..., num_features)`, as the environment returns them.
        mask: `(..., num_actions)` bool.

    Returns:
        The masked policy, and values `(...)` in units of the scaled reward.

    Raises:
        InputError: the network expects observations of another size.
    """
    output: Any = network.apply(weights.params, _normalized(weights, obs))
    logits, value = output
    return masked_categorical(logits * weights.sharpness, mask), value


def apply_value(network: nn.Module, weights: PolicyWeights, obs: jax.Array) -> jax.Array:
    """Values `(...)` at raw observations `(..., num_features)`; the compiler drops the unused actor."""
    output: Any = network.apply(weights.params, _normalized(weights, obs))
    return output[1]


def _normalized(weights: PolicyWeights, obs: jax.Array) -> jax.Array:
    """Normalised observations; refuses (InputError) another size, which would broadcast to the moments unnoticed."""
    there, wanted = jnp.shape(obs), weights.obs_stats.mean.shape
    if there[-1:] != wanted:
        raise InputError(f"obs has shape {there}, allowed: {wanted[0]} features in the last axis")
    return normalize(weights.obs_stats, obs)


def learned_policy(
    env: Environment,
    network: nn.Module,
    weights: PolicyWeights,
    decide_every: int = 1,
    stochastic: bool = False,
) -> Policy:
    """A policy that takes the network's most probable action, or samples one.

    Args:
        env: a single environment.
        network: an actor-critic.
        weights: learned weights.
        decide_every: decisions from one choice to the next, see `medjax.wrappers.DecideEvery`.
        stochastic: sample the action.
    """

    def act(given: PolicyWeights, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        distribution, _ = apply_policy(network, given, obs, env.action_mask(state, params))
        action = distribution.sample(seed=key) if stochastic else distribution.mode()
        return Choice(action.astype(jnp.int32), distribution.probs)

    return every(Policy(act, weights), decide_every)
