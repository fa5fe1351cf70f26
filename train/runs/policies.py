"""The policies of a run: what it learned, from its checkpoints, and the rules beside it."""

from pathlib import Path
from typing import Any

import jax

from medjax.errors import InputError
from medjax.numerics.devices import prepare_cpu
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.environments import make_environment
from train.algorithms.networks import PolicyWeights
from train.algorithms.registry import algorithm_of
from train.runs.checkpoint import Checkpoints
from train.settings import TrainConfig


def weight_shapes(env: Any, params: Any, config: TrainConfig) -> PolicyWeights:
    """Shapes and types of a run's weights, with a leading axis if it has several seeds; nothing is compiled."""
    shapes = algorithm_of(config).weight_shapes(env, params, config)
    seeds = (config.num_seeds,) if config.num_seeds > 1 else ()
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*seeds, *leaf.shape), leaf.dtype), shapes
    )


def load_weights(run_dir: Path, config: TrainConfig) -> tuple[Any, Any, PolicyWeights]:
    """A single environment, its parameters, and the newest weights of a run.

    Args:
        run_dir: directory of the run.
        config: its settings, or others of the same network.

    Raises:
        InputError: the environment cannot be made, or there is no checkpoint that fits it.
    """
    prepare_cpu()
    reader = Checkpoints(run_dir)
    if reader.latest() is None:
        raise InputError(f"run {run_dir} holds no checkpoint, allowed: one that train.ppo wrote")
    env, params = make_environment(config)
    return env, params, reader.restore_weights(weight_shapes(env, params, config))


def weights_by_name(config: TrainConfig, weights: PolicyWeights) -> dict[str, PolicyWeights]:
    """What each seed learned: of the first under the algorithm's name, of the others under that and `_seed2`, ...

    Args:
        config: settings of the run.
        weights: of the run, with a leading axis if it had several seeds.
    """
    if config.num_seeds == 1:
        return {config.algorithm: weights}
    names = [
        config.algorithm + (f"_seed{index + 1}" if index else "")
        for index in range(config.num_seeds)
    ]
    return {
        name: jax.tree.map(lambda leaf, i=index: leaf[i], weights)
        for index, name in enumerate(names)
    }


def all_policies(
    env: Any, config: TrainConfig, weights: PolicyWeights, stochastic: bool = False
) -> dict[str, Policy]:
    """The trained policies, named as in `weights_by_name`, and every rule.

    Args:
        env: a single environment.
        config: settings of the run.
        weights: of the run, with a leading axis if it had several seeds.
        stochastic: sample the trained policy's actions.
    """
    learn = algorithm_of(config)
    learned = {
        name: learn.policy(env, config, own, stochastic)
        for name, own in weights_by_name(config, weights).items()
    }
    return learned | {name: build(env) for name, build in BASELINES.items()}


def load_policies(
    run_dir: Path, config: TrainConfig, stochastic: bool
) -> tuple[Any, Any, dict[str, Policy]]:
    """A single environment, its parameters, and the trained and all other policies by name.

    Args:
        run_dir: directory of the run.
        config: its settings, or others of the same network.
        stochastic: sample the trained policy's actions.

    Raises:
        InputError: as `load_weights`.
    """
    env, params, weights = load_weights(run_dir, config)
    return env, params, all_policies(env, config, weights, stochastic)
