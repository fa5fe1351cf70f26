"""PPO: one update, and the compiled program of several.

The design is PureJaxRL's idea (environment, rollout, advantages and updates in one compiled program; Lu et al. 2022),
with the algorithm of Schulman et al. 2017 (arXiv:1707.06347).
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax import lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from medjax.wrappers import (
    BatchAutoReset,
    DecideEvery,
    Environment,
    EpisodeLog,
    RandomDemand,
    TimeLimitAsEnd,
    environment_mesh,
    on_devices,
)
from train.algorithms.advantages import generalized_advantages
from train.algorithms.finite import BAD, first_bad
from train.algorithms.networks import PolicyWeights, build_network, masked_categorical
from train.algorithms.normalization import (
    RunningStats,
    init_stats,
    normalize,
    scale_reward,
    update_stats,
)
from train.algorithms.ppo.losses import Batch, LossWeights, explained_variance, ppo_loss
from train.algorithms.rollout import EpisodeSums, RolloutState, Trajectory, collect, start
from train.settings import MOST_PER_CALL, TrainConfig

Metrics = dict[str, jax.Array]


@struct.dataclass
class TrainState:
    """All that changes in training; enough to go on from. With several seeds every leaf has a leading axis for them."""

    weights: PolicyWeights
    opt_state: Any
    rollout: RolloutState
    return_stats: RunningStats  # of the discounted return, scales rewards
    key: jax.Array  # typed PRNG key
    update: jax.Array  # () int32, updates done


@dataclasses.dataclass(frozen=True)
class Learner:
    """PPO for one seed, as pure functions of a `TrainState`."""

    env: EpisodeLog
    network: nn.Module
    optimizer: optax.GradientTransformation
    config: TrainConfig
    learning_rate: Callable[[jax.Array], jax.Array]  # of the number of updates done
    mesh: Mesh  # devices that share the environments

    def init(self, key: jax.Array, env_params: Any) -> TrainState:
        """The state before the first update."""
        reset_key, network_key, key = jax.random.split(key, 3)
        keys = jax.random.split(reset_key, self.config.num_envs)
        begin = on_devices(self.mesh, partial(start, self.env))
        rollout = begin(keys, env_params)
        params = self.network.init(network_key, rollout.obs[:1])
        return TrainState(
            weights=PolicyWeights(params, init_stats(rollout.obs.shape[1:])),
            opt_state=self.optimizer.init(params),
            rollout=rollout,
            return_stats=init_stats(),
            key=key,
            update=jnp.int32(0),
        )

    def update(self, state: TrainState, env_params: Any) -> tuple[TrainState, Metrics]:
        """A rollout, and the epochs of gradient steps on it.

        Observations are normalised by the same moments when acting and when learning from it; the moments take in the
        rollout only afterwards. Rewards are scaled by moments that include it.
        """
        rollout_key, shuffle_key, key = jax.random.split(state.key, 3)
        keys = jax.random.split(rollout_key, self.config.num_envs)
        rollout, trajectory, last_value, sums = on_devices(self.mesh, self._collect)(
            (state.rollout, keys), (state.weights, env_params)
        )
        return_stats = state.return_stats
        if self.config.normalize_rewards:
            return_stats = update_stats(return_stats, trajectory.discounted_sum)
        with jax.named_scope("advantages"):
            samples = self._samples(trajectory, last_value, state.weights, return_stats)
        with jax.named_scope("learn"):
            params, opt_state, metrics = self._learn(
                shuffle_key, samples, state.weights.params, state.opt_state
            )
        obs_stats = state.weights.obs_stats
        if self.config.normalize_observations:
            obs_stats = update_stats(obs_stats, trajectory.obs)
        metrics |= {
            "learning_rate": self.learning_rate(state.update),
            "explained_variance": explained_variance(samples.value, samples.target),
            "value_mean": jnp.mean(samples.value),
            "reward_std": jnp.sqrt(return_stats.var),
            "reward_mean": jnp.mean(trajectory.reward),
            **_episode_metrics(sums),
            BAD: first_bad(
                trajectory.obs,
                trajectory.reward,
                (trajectory.value, last_value),
                (samples.advantage, samples.target),
                metrics["loss"],
                metrics["grad_norm"],
                params,
                opt_state,
            ),
        }
        next_state = TrainState(
            weights=PolicyWeights(params, obs_stats),
            opt_state=opt_state,
            rollout=rollout,
            return_stats=return_stats,
            key=key,
            update=state.update + 1,
        )
        return next_state, metrics

    def run(
        self, state: TrainState, env_params: Any, num_updates: jax.Array
    ) -> tuple[TrainState, Metrics]:
        """Several updates.

        The number is an argument of the compiled program, not a part of it, and the program does not depend on how many
        the settings allow: run in whatever pieces, training takes the very same steps, bit for bit.

        Args:
            state: where training stands.
            env_params: parameters of the environments.
            num_updates: () int32, at most `MOST_PER_CALL`.

        Returns:
            The new state, and metrics `(MOST_PER_CALL,)`, of which the first `num_updates` entries are filled.
        """
        update = jax.jit(self.update)  # traced once for its shapes and its use
        _, shapes = jax.eval_shape(update, state, env_params)
        table = {
            name: jnp.full((MOST_PER_CALL,), 0 if name == BAD else jnp.nan, metric.dtype)
            for name, metric in shapes.items()
        }

        def body(index: jax.Array, carry: tuple[TrainState, Metrics]) -> tuple[TrainState, Metrics]:
            carried, rows = carry
            carried, metrics = update(carried, env_params)
            return carried, {name: rows[name].at[index].set(metrics[name]) for name in rows}

        return lax.fori_loop(jnp.int32(0), num_updates, body, (state, table))

    def _collect(
        self, rows: tuple[RolloutState, jax.Array], same: tuple[PolicyWeights, Any]
    ) -> tuple[RolloutState, Trajectory, jax.Array, EpisodeSums]:
        """The rollout of some of the environments."""
        (state, keys), (weights, env_params) = rows, same
        config = self.config
        return collect(
            self.env,
            self.network,
            weights,
            state,
            keys,
            env_params,
            num_steps=config.rollout_length,
            gamma=config.gamma,
        )

    def _samples(
        self,
        trajectory: Trajectory,
        last_value: jax.Array,
        weights: PolicyWeights,
        return_stats: RunningStats,
    ) -> Batch:
        """What the trajectory teaches; arrays stay `(num_envs, num_steps, ...)`."""
        estimate = partial(
            generalized_advantages, gamma=self.config.gamma, gae_lambda=self.config.gae_lambda
        )
        advantage, target = jax.vmap(estimate)(
            scale_reward(return_stats, trajectory.reward),
            trajectory.value,
            last_value,
            trajectory.terminated,
            trajectory.truncated,
            trajectory.final_value,
        )
        return Batch(
            obs=normalize(weights.obs_stats, trajectory.obs),
            mask=trajectory.mask,
            action=trajectory.action,
            log_prob=trajectory.log_prob,
            value=trajectory.value,
            advantage=advantage,
            target=target,
        )

    def _learn(
        self, key: jax.Array, samples: Batch, params: Any, opt_state: Any
    ) -> tuple[Any, Any, Metrics]:
        """Epochs of minibatches. Returns parameters, optimiser state and metrics averaged over the gradient steps."""
        config = self.config
        weights = LossWeights(
            config.clip_epsilon, config.value_coef, config.entropy_coef, config.clip_value
        )
        minibatches = split_environments(key, samples, config.num_minibatches)

        def loss_fn(candidate: Any, batch: Batch) -> tuple[jax.Array, Metrics]:
            output: Any = self.network.apply(candidate, batch.obs)
            logits, value = output
            return ppo_loss(masked_categorical(logits, batch.mask), value, batch, weights)

        def step(carry: tuple[Any, Any], batch: Batch) -> tuple[tuple[Any, Any], Metrics]:
            current, optimizer_state = carry
            gradient, metrics = jax.grad(loss_fn, has_aux=True)(current, batch)
            metrics["grad_norm"] = _norm(gradient)
            change, optimizer_state = self.optimizer.update(gradient, optimizer_state, current)
            return (optax.apply_updates(current, change), optimizer_state), metrics

        def epoch(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Metrics]:
            return lax.scan(step, carry, minibatches)

        (params, opt_state), metrics = lax.scan(
            epoch, (params, opt_state), None, length=config.num_epochs
        )
        return params, opt_state, jax.tree.map(jnp.mean, metrics)


def split_environments(key: jax.Array, samples: Any, num_minibatches: int) -> Any:
    """Deals the environments out: of every `num_minibatches` neighbours, each minibatch gets one by lot.

    Whole environments rather than single steps: dealing environments is cheap, and the rollout keeps its layout
    (sorting all steps costs more than it decorrelates). Among neighbours rather than among all: environments are alike,
    so that nothing is lost by it, and devices that share them need not exchange samples.

    Args:
        key: of the lots.
        samples: leaves `(num_envs, ...)`.
        num_minibatches: a divisor of num_envs.

    Returns:
        Leaves `(num_minibatches, num_envs / num_minibatches, ...)`; each sample is in exactly one minibatch.
    """
    num_envs = jax.tree.leaves(samples)[0].shape[0]
    places = jnp.broadcast_to(
        jnp.arange(num_minibatches), (num_envs // num_minibatches, num_minibatches)
    )
    lots = jax.random.permutation(key, places, axis=1, independent=True)

    def deal(values: jax.Array) -> jax.Array:
        groups = values.reshape(-1, num_minibatches, *values.shape[1:])
        return jax.vmap(lambda group, lot: group[lot], out_axes=1)(groups, lots)

    return jax.tree.map(deal, samples)


def _norm(tree: Any) -> jax.Array:
    """Euclidean norm of all leaves together."""
    return jnp.sqrt(sum(jnp.sum(jnp.square(leaf)) for leaf in jax.tree.leaves(tree)))


def _episode_metrics(sums: EpisodeSums) -> Metrics:
    """Means over the whole episodes that ended in the rollout; NaN if none did."""
    *totals, count = jnp.sum(sums.total, axis=0)
    return {
        "episodes": count,
        **{
            f"episode_{name}": total / count for name, total in zip(sums.names, totals, strict=True)
        },
    }


def episode_decisions(params: Any) -> int:
    """Decisions until an episode is truncated, as the parameters say; 0 if they do not."""
    return int(getattr(params, "episode_decisions", 0))


def build_learner(env: Environment, params: Any, config: TrainConfig) -> Learner:
    """PPO on `env` with `config`.

    Args:
        env: a single environment; it is copied `config.num_envs` times here.
        params: its parameters, read only for the length of an episode.
        config: settings.

    Raises:
        InputError: `config.num_devices` is not possible.
    """
    episode_choices = -(-episode_decisions(params) // config.decide_every)
    network = build_network(env, config)
    # A device holds whole groups of the neighbours among which minibatches are dealt.
    mesh = environment_mesh(
        config.num_envs // config.num_minibatches, config.num_devices, jax.devices()
    )
    if config.demand_range != (1.0, 1.0):
        env = RandomDemand(env, *config.demand_range)
    if not config.bootstrap_timeouts:
        env = TimeLimitAsEnd(env)
    batch = BatchAutoReset(
        DecideEvery(env, config.decide_every), stagger=episode_choices if config.stagger else 0
    )
    gradient_steps = config.num_epochs * config.num_minibatches

    def learning_rate(update: jax.Array) -> jax.Array:
        left = 1.0 - update / config.num_updates if config.anneal else 1.0
        return jnp.float32(config.learning_rate * left)

    # All parameters as one vector: a few operations for all layers instead of a few for each array.
    optimizer = optax.flatten(
        optax.chain(
            optax.clip_by_global_norm(config.max_grad_norm),
            optax.adam(lambda count: learning_rate(count // gradient_steps), eps=1e-5),
        )
    )
    return Learner(EpisodeLog(batch), network, optimizer, config, learning_rate, mesh)


@dataclasses.dataclass(frozen=True)
class TrainFunctions:
    """The two programs of training, over all seeds at once."""

    init: Callable[[jax.Array, Any], TrainState]  # (key, env_params)
    run: Callable[[TrainState, Any, jax.Array], tuple[TrainState, Metrics]]  # see Learner.run
    shardings: Any  # of the state, a prefix of its tree


def make_train(env: Environment, params: Any, config: TrainConfig) -> TrainFunctions:
    """Compilable training.

    Args:
        env: a single environment.
        params: its parameters; see `build_learner`.
        config: settings.

    Returns:
        Jitted functions (also for ahead-of-time compilation by `.lower`); `run` donates its state. With
        `config.num_seeds > 1` every leaf of the state and of the metrics has a leading axis of that length.
    """
    learner = build_learner(env, params, config)
    init: Callable[[jax.Array, Any], TrainState] = learner.init
    run: Callable[[TrainState, Any, jax.Array], tuple[TrainState, Metrics]] = learner.run
    if config.num_seeds > 1:
        # One after the other: each runs as fast as alone, its environments in the cache, its matrices plain.
        # Under vmap over seeds and environments, XLA's CPU program of a reset never returns.
        def run(
            states: TrainState, env_params: Any, num_updates: jax.Array
        ) -> tuple[TrainState, Metrics]:
            return lax.map(lambda own: learner.run(own, env_params, num_updates), states)

        def init(key: jax.Array, env_params: Any) -> TrainState:
            keys = jax.random.split(key, config.num_seeds)
            return lax.map(lambda own: learner.init(own, env_params), keys)

    where = shardings(learner.mesh, seeds=config.num_seeds > 1)
    return TrainFunctions(
        init=jax.jit(init, out_shardings=where),
        run=jax.jit(
            run,
            in_shardings=(where, None, None),
            out_shardings=(where, NamedSharding(learner.mesh, PartitionSpec())),
            donate_argnums=0,
        ),
        shardings=where,
    )


def shardings(mesh: Mesh, seeds: bool) -> Any:
    """Where the parts of a `TrainState` are: what belongs to environments is shared out, the rest is everywhere."""
    everywhere = NamedSharding(mesh, PartitionSpec())
    rows = NamedSharding(mesh, PartitionSpec(*([None] if seeds else []), *mesh.axis_names))
    parts: dict[str, Any] = dict.fromkeys(TrainState.__dataclass_fields__, everywhere)
    return TrainState(**parts | {"rollout": rows})
