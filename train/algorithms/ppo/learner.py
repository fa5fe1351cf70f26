"""PPO (Schulman et al. 2017, arXiv:1707.06347): one update."""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh

from medjax.env.contract import Environment
from medjax.episodes.runner import episode_decisions
from medjax.numerics.devices import environment_mesh, on_devices
from train.algorithms.advantages import (
    Steps,
    generalized_advantages,
    leave_one_out_baseline,
    needs_bootstrap,
)
from train.algorithms.algorithm import Algorithm, Metrics, TrainState, first_weights
from train.algorithms.environments import training_batch
from train.algorithms.finite import BAD, first_bad
from train.algorithms.minibatches import run_epochs, split_environments
from train.algorithms.networks import PolicyWeights, apply_policy, build_network
from train.algorithms.normalization import RunningStats, init_stats, scale_reward, update_stats
from train.algorithms.ppo.losses import Batch, explained_variance, leaves_choice, ppo_loss, weigh
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.rollout import Collector, Trajectory, episode_metrics, spread

# Share of the updates after which the policy is as sharp as it gets, so that it is learned as it is played.
SHARP_AFTER = 0.7
# Most by which an update multiplies the logits. If few updates had to sharpen the policy fully, it would change by that
# more than by learning, and would come to wait for good.
MOST_SHARPENED = 1.04


@struct.dataclass
class PPOState(TrainState):
    """The training state of PPO."""

    opt_state: Any
    return_stats: RunningStats  # of the discounted return; they scale rewards


@dataclasses.dataclass(frozen=True)
class PPOLearner:
    """PPO for one seed; see `train.algorithms.algorithm.Learner`."""

    collector: Collector
    optimizer: optax.GradientTransformation
    config: PPOConfig
    learning_rate: Callable[[jax.Array], jax.Array]  # function of the number of updates done
    sharpness: Callable[[jax.Array], jax.Array]  # of the policy; function of the same number
    mesh: Mesh  # devices that share the environments
    state: ClassVar[type[PPOState]] = PPOState

    def init(self, key: jax.Array, env_params: Any) -> PPOState:
        """The state before the first update."""
        reset_key, _, next_key = jax.random.split(key, 3)
        keys = jax.random.split(reset_key, self.config.num_envs)
        start = on_devices(self.mesh, self.collector.start, group=self.config.group_size)
        rollout = start(keys, env_params)
        weights = first_weights(self.collector.network, key, rollout.obs.shape[-1:])
        opt_state, return_stats = self.optimizer.init(weights.params), init_stats()
        return PPOState(weights, rollout, next_key, jnp.int32(0), opt_state, return_stats)

    def update(self, state: PPOState, env_params: Any) -> tuple[PPOState, Metrics]:
        """One rollout, then epochs of gradient steps on it.

        Acting and learning normalise observations by the same moments, which take in the rollout only afterwards.
        Rewards are scaled by moments that already include it.
        """
        rollout_key, shuffle_key, key = jax.random.split(state.key, 3)
        keys = jax.random.split(rollout_key, self.config.num_envs)
        # The trajectory keeps the layout of the rollout, (steps, environments), because observations are large. They
        # are copied only if a device splits its environments into blocks.
        collect = on_devices(
            self.mesh,
            lambda rows, same: self.collector.collect(same[0], rows[0], rows[1], same[1]),
            out_axes=(0, 1, 0, 0),
            group=self.config.group_size,
        )
        rollout, trajectory, last_value, sums = collect(
            (state.rollout, keys), (state.weights, env_params)
        )
        return_stats = state.return_stats
        if self.config.normalize_rewards:
            return_stats = update_stats(return_stats, trajectory.discounted_sum)
        with jax.named_scope("advantages"):
            samples = self._samples(trajectory, last_value, return_stats)
        with jax.named_scope("learn"):
            seen = trajectory.obs, trajectory.mask
            params, opt_state, metrics = self._learn(
                shuffle_key, seen, samples, state.weights, state.opt_state
            )
        obs_stats = state.weights.obs_stats
        if self.config.normalize_observations:
            obs_stats = update_stats(obs_stats, trajectory.obs)
        metrics |= {
            "learning_rate": self.learning_rate(state.update),
            "explained_variance": explained_variance(
                samples.value, samples.target, samples.value_weight
            ),
            "value_mean": jnp.mean(samples.value),
            "reward_std": jnp.sqrt(return_stats.var),
            "reward_mean": jnp.mean(trajectory.reward),
            **episode_metrics(sums),
            BAD: first_bad(
                observations=trajectory.obs,
                rewards=trajectory.reward,
                values=(trajectory.value, last_value),
                advantages=(samples.advantage, samples.target),
                loss=metrics["loss"],
                gradient=metrics["grad_norm"],
                parameters=params,
                optimizer_state=opt_state,
            ),
        }
        done = state.update + 1
        weights = PolicyWeights(params, obs_stats, self.sharpness(done))
        return PPOState(weights, rollout, key, done, opt_state, return_stats), metrics

    def _samples(
        self, trajectory: Trajectory, last_value: jax.Array, return_stats: RunningStats
    ) -> Batch:
        """The samples of a trajectory; arrays are `(num_envs, num_steps, ...)`."""
        steps = Steps(
            reward=scale_reward(return_stats, trajectory.reward),
            value=trajectory.value,
            terminated=spread(trajectory.terminated, trajectory.value),
            truncated=spread(trajectory.truncated, trajectory.value),
            final_value=trajectory.final_value,
        )
        advantage, target = generalized_advantages(
            steps, last_value, gamma=self.config.gamma, gae_lambda=self.config.gae_lambda
        )
        chosen = leaves_choice(trajectory.mask)
        everywhere = needs_bootstrap(steps, self.config.gae_lambda)
        batch = Batch(
            action=trajectory.action,
            log_prob=trajectory.log_prob,
            value=trajectory.value,
            advantage=advantage,
            target=target,
            weight=chosen.astype(jnp.float32),
            value_weight=(chosen | everywhere).astype(jnp.float32),
        )
        batch = jax.tree.map(lambda leaf: jnp.swapaxes(leaf, 0, 1), batch)
        of_demand = leave_one_out_baseline(batch.advantage, self.config.group_size)
        return dataclasses.replace(batch, advantage=of_demand)

    def _learn(
        self,
        key: jax.Array,
        seen: tuple[jax.Array, jax.Array],
        samples: Batch,
        weights: PolicyWeights,
        opt_state: Any,
    ) -> tuple[Any, Any, Metrics]:
        """Runs all epochs; returns parameters, optimiser state, and metrics averaged over the gradient steps."""
        numbers = jnp.arange(self.config.num_envs, dtype=jnp.int32)
        numbers, samples = split_environments(key, (numbers, samples), self.config.minibatches)
        samples = jax.vmap(weigh)(samples)
        teaches = (samples.weight > 0.0) | (samples.value_weight > 0.0)

        def loss_fn(
            candidate: Any, seen: tuple[jax.Array, jax.Array], batch: Batch
        ) -> tuple[jax.Array, Metrics]:
            """Loss `()` and metrics of some rows: observations `(some, num_features)`, masks, samples `(some,)`."""
            obs, mask = seen
            policy, value = apply_policy(
                self.collector.network, dataclasses.replace(weights, params=candidate), obs, mask
            )
            return ppo_loss(policy, value, batch, self.config)

        return run_epochs(
            loss_fn,
            self.optimizer,
            (weights.params, opt_state),
            seen,
            (numbers, teaches, samples),
            self.config.num_epochs,
            self.mesh,
        )


def build_learner(env: Environment, params: Any, config: PPOConfig) -> PPOLearner:
    """PPO on `env` with `config`.

    Args:
        env: a single environment; the learner makes `config.num_envs` copies of it.
        params: its parameters; only the length of an episode is read.
        config: settings.

    Raises:
        InputError: `config.num_devices` is not possible.
    """
    config = config.for_episodes(episode_decisions(params))
    network = build_network(env, config)
    mesh = environment_mesh(config.device_groups, config.num_devices, jax.devices())
    batch = training_batch(env, params, config, config.bootstrap_timeouts)
    gradient_steps = config.num_epochs * config.minibatches

    def learning_rate(update: jax.Array) -> jax.Array:
        left = 1.0 - update / config.num_updates if config.anneal else 1.0
        return jnp.float32(config.learning_rate * left)

    def sharpness(update: jax.Array) -> jax.Array:
        done = jnp.minimum(update / (SHARP_AFTER * config.num_updates), 1.0)
        return jnp.float32(jnp.minimum(config.sharpening**done, MOST_SHARPENED**update))

    # On one flat vector the optimiser needs a few operations for all layers, instead of a few per array.
    optimizer = optax.flatten(
        optax.chain(
            optax.clip_by_global_norm(config.max_grad_norm),
            optax.adam(lambda count: learning_rate(count // gradient_steps), eps=1e-5),
        )
    )
    collector = Collector(batch, network, config.choices_per_update, config.gamma)
    return PPOLearner(collector, optimizer, config, learning_rate, sharpness, mesh)


PPO = Algorithm(PPOConfig, build_network, build_learner)
