"""The base policy that a study improves on: its options, and plans that deviate from it."""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from benchmarks.command import a_path
from medjax.episodes.runner import EpisodeRunner, Episodes
from medjax.errors import InputError
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.environments import make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play

AS_BASE = -1  # the plan to go on with the base policy


def add_base(parser: argparse.ArgumentParser) -> None:
    """Adds the options that `load` reads."""
    parser.set_defaults(scenario=None)  # the run's, else the default of train.ppo
    improved = "run whose first learner the study improves on"
    parser.add_argument("--run-dir", type=a_path, metavar="DIR", help=improved)
    rules = sorted({*BASELINES} - {"slow"})
    rule = "rule that the study improves on (default: budgeted)"
    parser.add_argument("--base", choices=rules, help=rule)


def load(options: argparse.Namespace) -> tuple[str, Any, Any, str, dict[str, Policy]]:
    """Scenario, environment, parameters, name of the base policy, and all policies by name.

    Raises:
      InputError: the run cannot be read or is of agents, or --base is given too.
    """
    if not options.run_dir:
        config = to_play(PPOConfig(), options.scenario)
        env, params = make_environment(config)
        rules = {name: build(env) for name, build in BASELINES.items()}
        return config.scenario, env, params, options.base or "budgeted", rules
    if options.base:
        raise InputError(f"--base is {options.base} with --run-dir, allowed: one of the two")
    config = to_play(RunDir(options.run_dir).load_config(), options.scenario)
    if config.agents != "none":
        raise InputError(f"--run-dir {options.run_dir} is of agents, allowed: of a dispatcher")
    env, params, policies = load_policies(options.run_dir, config, stochastic=False)
    return config.scenario, env, params, config.algorithm, policies


def follow(
    runner: EpisodeRunner,
    weights: Any,
    rows: tuple[Episodes, jax.Array],
    first: jax.Array,
    ends: tuple[jax.Array | int, int],
    params: Any,
) -> Episodes:
    """Plays episodes on: first by their plans, then by the base policy.

    Args:
      runner: of the base policy.
      weights: of the base policy.
      rows: the episodes so far, and the plan of each, (rows,) int32: AS_BASE, or an action that is taken
        once and followed by action 0 for the rest of the plan.
      first: () int32, the decision at which the plans start.
      ends: the decision to stop before, and the length of the plans in decisions.
      params: of the environment.
    """
    (played, plans), (last, hold) = rows, ends

    def decide(number: jax.Array, played: Episodes) -> Episodes:
        choice = runner.choose(played, number, [weights], params)
        follows = (plans == AS_BASE) | (number >= first + hold)
        own = jnp.where(number == first, plans, 0)
        held = choice._replace(action=jnp.where(follows, choice.action, own))
        return runner.go_on(played, number, held, params)[0]

    return lax.fori_loop(first, last, decide, played)
