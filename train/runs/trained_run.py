"""What the commands on a trained run share: their options, their numbers and what they load."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from medjax.commandline import OneLineParser
from medjax.errors import InputError
from train.arguments import make_environment
from train.settings import Override, TrainConfig

if TYPE_CHECKING:
    from medjax.policies.policy import Policy

TRAINED = "ppo"  # name of the learned policy, that of the first seed
LIMITS = {"episodes": (2, 10**7), "batch": (1, 10**6), "seed": (0, 2**32 - 1)}


def trained_run_parser(prog: str, description: str) -> OneLineParser:
    """The parser of a command that plays whole episodes with the policy in `--run-dir DIR`."""
    parser = OneLineParser(prog=f"python -m {prog}", description=description)
    parser.add_argument(
        "--run-dir", required=True, metavar="DIR", help="directory that train.ppo wrote"
    )
    parser.add_argument(
        "--episodes", default="200", metavar="N", help="whole episodes per policy (default: 200)"
    )
    parser.add_argument("--seed", default="0", metavar="N", help="which episodes (default: 0)")
    parser.add_argument(
        "--stochastic",
        action="store_true",
        help="sample the trained policy's actions; else the most probable",
    )
    return parser


def to_play(
    config: TrainConfig,
    scenario: str | None = None,
    changes: Mapping[str, Override] | None = None,
) -> TrainConfig:
    """Settings of a run, for playing it here, in the environment that is asked for.

    Args:
        config: of the run.
        scenario: preset; None is that of the run.
        changes: numbers of the environment, over those of the run where the preset is its own: what was set for one may
            mean nothing in another.
    """
    scenario = config.scenario if scenario is None else scenario
    kept = config.overrides if scenario == config.scenario else {}
    overrides = {**kept, **(changes or {})}
    # This machine need not have the devices that the run had.
    return dataclasses.replace(config, scenario=scenario, overrides=overrides, num_devices=0)


def load_weights(run_dir: Path, config: TrainConfig) -> tuple[Any, Any, Any]:
    """A single environment, its parameters, and the newest weights of a run.

    Args:
        run_dir: directory of the run.
        config: its settings, or others of the same network.

    Raises:
        InputError: the environment cannot be made, or there is no checkpoint that fits it.
    """
    # JAX takes seconds to import; bad options need not wait for them.
    from medjax.wrappers import prepare_cpu

    prepare_cpu()
    from train.algorithms.ppo.learner import make_train
    from train.runs.checkpoint import Checkpoints
    from train.runs.session import shapes_of

    reader = Checkpoints(run_dir)
    if reader.latest() is None:
        raise InputError(f"run {run_dir} holds no checkpoint, allowed: one that train.ppo wrote")
    env, params = make_environment(config)
    shapes = shapes_of(make_train(env, params, config), params, config)
    return env, params, reader.restore_weights(shapes)


def load_policies(
    run_dir: Path, config: TrainConfig, stochastic: bool
) -> tuple[Any, Any, dict[str, "Policy"]]:
    """A single environment, its parameters, and the trained and all other policies by name.

    Args:
        run_dir: directory of the run.
        config: its settings, or others of the same network.
        stochastic: sample the trained policy's actions.

    Raises:
        InputError: as `load_weights`.
    """
    env, params, weights = load_weights(run_dir, config)
    from train.runs.finish import all_policies

    return env, params, all_policies(env, config, weights, stochastic)
