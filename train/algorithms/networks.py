"""Actor-critic networks and the masked policy distribution.

A network maps normalised observations `(..., num_features)` to action logits `(..., num_actions)` and values `(...)`,
both float32 whatever type it computes in. `NETWORKS` lists the builders; each entry is a choice of `--network`.
"""

import math
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
from medjax.env.observation import FlatObservation, RoadProfile
from medjax.errors import InputError, shown
from medjax.policies.policy import Choice, Policy, every
from medjax.policies.rules import BUDGET
from medjax.world.params import EnvConfig
from medjax.world.state import IN_SERVICE, MERGING, QUEUED
from train.algorithms.normalization import RunningStats, normalize
from train.settings import TrainConfig

SHARPNESS = 4.0  # logits per EV in the initial policy
GOES_ON = 0.99  # initial probability that an agent stays, rather than leaves the road for good
TYPICAL_NUMBER = 8.0  # vehicles in a set
MASKED_LOGIT = -1e9  # finite to keep log-probabilities and gradients finite; its exp() is exactly 0

ACTIVATIONS = {"tanh": nn.tanh, "relu": nn.relu, "silu": nn.silu}
DTYPES = {"float32": jnp.float32, "bfloat16": jnp.bfloat16}


@struct.dataclass
class PolicyWeights:
    """Everything that acting needs: a trained policy."""

    params: Any  # of the network
    obs_stats: RunningStats  # moments that normalise observations


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
    """MEDs and EVs as sets (Deep Sets, Zaheer et al. 2017, arXiv:1703.06114): their order does not matter.

    Reads a flat observation. One encoder per kind encodes each vehicle. The codes are summed over the vehicles present;
    the sums and the clock go through fully connected layers. A row of zeros is an empty slot.
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

    Initialisation is orthogonal. The actor's last layer starts near zero (0.01), which puts the initial policy near
    that of `start` (Andrychowicz et al. 2021, arXiv:2006.05990, section 3.2; residual policy learning, Silver et al.
    2018, arXiv:1812.06298).
    """

    num_logits: int
    make_torso: Callable[[], nn.Module]  # all layers but the last
    start: Callable[[jax.Array], jax.Array]  # observations to the logits that learning adds to
    fold: Callable[[jax.Array], jax.Array]  # `(..., num_logits)` to logits of the actions
    acts_on: int  # leading features that the actor sees; the critic sees all

    def setup(self) -> None:
        """Makes the layers."""
        self.actor = self.make_torso()
        self.critic = self.make_torso()
        small, unit = nn.initializers.orthogonal(0.01), nn.initializers.orthogonal(1.0)
        self.logits_head = nn.Dense(self.num_logits, kernel_init=small, dtype=jnp.float32)
        self.value_head = nn.Dense(1, kernel_init=unit, dtype=jnp.float32)

    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """`(..., num_features)` to logits `(..., num_actions)` and values `(...)`."""
        acted_on = obs[..., : self.acts_on]
        logits = self.start(obs) + self.logits_head(self.actor(acted_on).astype(jnp.float32))
        value = self.value_head(self.critic(obs).astype(jnp.float32))
        return self.fold(logits), value[..., 0]


def first_logits(env: Environment, config: TrainConfig) -> Callable[[jax.Array], jax.Array]:
    """The initial dispatcher, from observations `(..., num_features)` to logits; see `TrainConfig.start`."""
    layout = env.observation
    ramps = env.config.num_ramps if isinstance(layout, AgentView) else env.num_actions - 1
    # The rule does not cover actions that a wrapper has added or removed.
    rule = isinstance(layout, RoadProfile | AgentView) and 0 < ramps == env.config.num_ramps
    if config.start == "rule" and rule:
        env_config = env.config

        def like_rule(obs: jax.Array) -> jax.Array:
            margin = BUDGET.margin(*layout.outlook(obs, env_config))
            return jnp.pad(SHARPNESS * margin, [(0, 0)] * (obs.ndim - 1) + [(1, 0)])

        return like_rule
    logits = _mostly(0, 1 + ramps, config.initial_wait)
    return lambda obs: jnp.broadcast_to(logits, (*obs.shape[:-1], 1 + ramps))


def _mostly(usual: int, choices: int, probability: float) -> jax.Array:
    """Logits `(choices,)` that give one choice this probability and share the rest equally."""
    odds = math.log(probability / (1.0 - probability) * max(choices - 1, 1))
    return jnp.zeros((choices,), jnp.float32).at[usual].set(odds)


def first_logits_of_agents(env: Any, config: TrainConfig) -> Callable[[jax.Array], jax.Array]:
    """The initial agents, from observations `(..., num_features)` to logits of all parts of an action.

    At the depot an agent starts like a dispatcher (`first_logits`). In service it most likely does what the rule does.
    """
    enter, likely = first_logits(env, config), config.initial_wait
    _, speed, lane, accept, leave = env.actions.parts
    parts = [
        _mostly(env.actions.usual[0], speed.n, likely),
        _mostly(env.actions.usual[1], lane.n, likely),
        _mostly(1, accept.n, likely),
        _mostly(0, leave.n, GOES_ON),
    ]
    motion = jnp.concatenate(parts)

    def start(obs: jax.Array) -> jax.Array:
        # A MED that was sent chooses every part itself, so "do as the rule does" is masked, too.
        sent = obs[..., QUEUED, None] + obs[..., MERGING, None] + obs[..., IN_SERVICE, None]
        at_depot = jnp.where(sent > 0.5, MASKED_LOGIT, enter(obs))
        of_parts = jnp.broadcast_to(motion, (*obs.shape[:-1], motion.shape[0]))
        return jnp.concatenate([at_depot, of_parts], axis=-1)

    return start


def mlp(env: Environment, config: TrainConfig) -> Callable[[], nn.Module]:
    """Fully connected layers for any observation."""
    activation, dtype = ACTIVATIONS[config.activation], DTYPES[config.compute_dtype]
    return partial(Torso, config.hidden, activation, dtype)


def sets(env: Environment, config: TrainConfig) -> Callable[[], nn.Module]:
    """`SetTorso` for the paper's flat observation; `check_network` refuses others."""
    activation, dtype = ACTIVATIONS[config.activation], DTYPES[config.compute_dtype]
    layers = config.encoder, config.hidden, activation, dtype
    return partial(SetTorso, env.observation, env.config, *layers)


NETWORKS = {"mlp": mlp, "sets": sets}


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
        config: settings.

    Raises:
        InputError: an unknown network, or one that does not fit the observation.
    """
    check_network(config, env.observation)
    make_torso = NETWORKS[config.network](env, config)
    if isinstance(env.observation, AgentView):
        agents: Any = env
        actions, seen = agents.actions, env.observation.own_size(env.config)
        start = first_logits_of_agents(env, config)
        return ActorCritic(actions.num_logits, make_torso, start, actions.fold_logits, seen)
    (size,) = env.observation_space(None).shape
    return ActorCritic(
        env.num_actions, make_torso, first_logits(env, config), lambda logits: logits, size
    )


def masked_categorical(logits: jax.Array, mask: jax.Array) -> Categorical:
    """Distribution over the allowed actions.

    Args:
        logits: `(..., num_actions)` float32.
        mask: `(..., num_actions)` bool, True = allowed; at least one per entry.

    Returns:
        A categorical distribution in which masked actions have probability exactly 0 and add nothing to the entropy.
    """
    return Categorical(logits=jnp.where(mask, logits, MASKED_LOGIT), dtype=jnp.int32)


def sample_each(policy: Categorical, keys: jax.Array) -> jax.Array:
    """A sample from each of the distributions `(rows,)`, each with its own key `(rows,)`."""
    return jax.vmap(lambda own, key: own.sample(seed=key))(policy, keys)


def apply_policy(
    network: nn.Module, weights: PolicyWeights, obs: jax.Array, mask: jax.Array
) -> tuple[Categorical, jax.Array]:
    """Policy and value at raw observations.

    Args:
        network: the network.
        weights: parameters, and the moments that normalise observations.
        obs: `(..., num_features)`, as the environment returns them.
        mask: `(..., num_actions)` bool.

    Returns:
        The masked policy, and values `(...)` in units of the scaled reward.

    Raises:
        InputError: the network expects observations of another size.
    """
    output: Any = network.apply(weights.params, _normalized(weights, obs))
    logits, value = output
    return masked_categorical(logits, mask), value


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
