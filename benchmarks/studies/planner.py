"""`python -m benchmarks.planner`: what a dispatcher that owns a simulator reaches, an upper reference.

`medjax.policies.look_ahead` plays every action forward with fresh noise and then a base, a rule or a learner, and
leaves the base where that surely pays. The episodes are those that `python -m train.evaluate` plays for the same seed,
so that returns of both commands stand beside each other. Slow: for an episode it plays
`samples * actions * decisions / hold / 2` others.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import medjax
from benchmarks.command import a_path, episodes_parser, positive, whole_number
from medjax.commandline import OneLineParser
from medjax.env.metrics import episode_metrics
from medjax.episodes.keys import ACT, RESET, STEP, episode_keys
from medjax.errors import InputError
from medjax.policies.rules import AS_BASE, BASELINES, Act, look_ahead
from medjax.wrappers import environment_mesh, on_devices, prepare_cpu
from train.algorithms.environments import make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.scores import TRAINED, Policy, Scores, baseline, evaluate_policies
from train.evaluation.statistics import bootstrap_ci95
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play

SHOWN = ("depleted_share", "mean_range_m", "mean_soc", "meds_dispatched")


def play_plans(
    env: medjax.ChargingEnv, params: Any, plan: Act, base: Act, hold: int, episodes: int, seed: int
) -> Scores:
    """Whole episodes of a planner that is asked at every `hold`-th decision.

    Args:
      env: a single environment.
      params: its parameters.
      plan: as `medjax.policies.look_ahead` returns it.
      base: what is played where it says AS_BASE.
      hold: at least 1.
      episodes: at least 1; all are played together.
      seed: which episodes, as in `train.evaluation.scores`.

    Returns:
      As `train.evaluation.scores.Evaluation.play`, for one policy.
    """
    mesh = environment_mesh(episodes)
    streams = jax.vmap(jax.random.split, (0, None))(episode_keys(seed, episodes), 3)

    def ask(rows: tuple[jax.Array, Any], params: Any) -> jax.Array:
        """What to hold; keys of their own stream, so that the futures that are tried are not what will happen."""

        def one(row: tuple[jax.Array, Any]) -> jax.Array:
            key, state = row
            key = jax.random.fold_in(key, state.time)
            can_send = jnp.any(env.action_mask(state, params)[1:])
            return jax.lax.cond(
                can_send, lambda: plan(key, state, params), lambda: jnp.int32(AS_BASE)
            )

        # One episode after the other: its futures fill the cache.
        return jax.lax.map(one, rows)

    def go_on(rows: tuple[jax.Array, Any, jax.Array, jax.Array], params: Any) -> Any:
        """The decisions until the planner is asked again."""
        streams, states, totals, plans = rows

        def decide(
            streams: jax.Array, state: Any, total: jax.Array, plan: jax.Array, number: jax.Array
        ) -> tuple[Any, jax.Array]:
            live = state.time < params.episode_decisions
            keys = jax.vmap(jax.random.fold_in, (0, None))(streams, state.time)
            own = jnp.where(number == 0, plan, 0)
            action = jnp.where(plan == AS_BASE, base(keys[ACT], state, params), own)
            _, after, reward, *_ = env.step_env(keys[STEP], state, action, params)
            state = jax.tree.map(lambda new, old: jnp.where(live, new, old), after, state)
            return state, total + jnp.where(live, reward, 0.0)

        def body(number: jax.Array, carry: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
            return jax.vmap(decide, (0, 0, 0, 0, None))(streams, *carry, plans, number)

        return jax.lax.fori_loop(0, hold, body, (states, totals))

    ask, go_on = jax.jit(on_devices(mesh, ask)), jax.jit(on_devices(mesh, go_on))
    _, states = jax.jit(jax.vmap(env.reset, (0, None)))(streams[:, RESET], params)
    totals = jnp.zeros((episodes,))
    asked = -(-int(params.episode_decisions) // hold)
    for _ in tqdm(range(asked), "planning", disable=None, leave=False):
        plans = ask((streams[:, ACT], states), params)
        states, totals = go_on((streams, states, totals, plans), params)
    scores = {"return": totals, **jax.vmap(episode_metrics)(states.tally)}
    return {name: np.asarray(values, np.float64) for name, values in scores.items()}


def as_act(env: medjax.ChargingEnv, policy: Policy) -> Act:
    """A policy as a base: it sees what the environment shows."""

    def act(key: jax.Array, state: Any, params: Any) -> jax.Array:
        obs, mask = env.observation(state, env.config, params), env.action_mask(state, params)
        return policy.act(policy.weights, key, obs, state, mask, params)

    return act


def build_parser() -> OneLineParser:
    """The command line."""
    parser = episodes_parser("planner", __doc__, episodes=16, seed=0)
    parser.set_defaults(scenario=None)  # that of the run, else the default of train.ppo
    parser.add_argument(
        "--run-dir", type=a_path, metavar="DIR", help="run whose first learner is improved on"
    )
    parser.add_argument(
        "--base", choices=list(BASELINES), help="rule that is improved on (default: forecast)"
    )
    parser.add_argument(
        "--samples", type=whole_number(least=2), default=16, help="futures of each action"
    )
    parser.add_argument(
        "--hold", type=positive, default=16, metavar="N", help="decisions from plan to plan"
    )
    return parser


def load(options: argparse.Namespace) -> tuple[str, Any, Any, str, dict[str, Policy]]:
    """Scenario, environment, parameters, name of the base, and all policies by name.

    Raises:
      InputError: the run cannot be read, or a base is given too.
    """
    if not options.run_dir:
        config = to_play(PPOConfig(), options.scenario)
        env, params = make_environment(config)
        rules = {name: baseline(build(env)) for name, build in BASELINES.items()}
        return config.scenario, env, params, options.base or "forecast", rules
    if options.base:
        raise InputError(f"--base is {options.base} with --run-dir, allowed: one of the two")
    config = to_play(RunDir(options.run_dir).load_config(), options.scenario)
    env, params, policies = load_policies(options.run_dir, config, stochastic=False)
    return config.scenario, env, params, TRAINED, policies


def main(arguments: list[str] | None = None) -> None:
    """Prints the planner's, its base's and no action's scores."""
    parser = build_parser()
    options = parser.parse_args(arguments)
    prepare_cpu()
    try:
        scenario, env, params, base, policies = load(options)
    except InputError as error:
        parser.error(str(error))
    act = as_act(env, policies[base])
    plan = look_ahead(env, act, options.samples, options.hold)
    scores = {
        "planner": play_plans(env, params, plan, act, options.hold, options.episodes, options.seed)
    }
    others = {name: policies[name] for name in dict.fromkeys([base, "none"])}
    scores |= evaluate_policies(env, params, others, options.episodes, options.seed)
    rows = {}
    print(f"{options.episodes} episodes of {scenario}, seed {options.seed}")
    print(f"{'policy':<10}{'return':>9}{'95 % CI':>20}" + "".join(f"{name:>17}" for name in SHOWN))
    for name, score in scores.items():
        low, high = bootstrap_ci95(score["return"])
        means = {metric: float(values.mean()) for metric, values in score.items()}
        rows[name] = means | {"return_ci95": [low, high]}
        shown = "".join(f"{means[metric]:17.3f}" for metric in SHOWN)
        print(f"{name:<10}{means['return']:9.1f}{f'[{low:.1f}, {high:.1f}]':>20}{shown}")
    gain = scores["planner"]["return"] - scores[base]["return"]
    low, high = bootstrap_ci95(gain)
    print(f"planner minus {base}: {gain.mean():.1f} [{low:.1f}, {high:.1f}]")
    if options.json:
        gained = {"mean": float(gain.mean()), "ci95": [low, high]}
        report = {"policies": rows, "planner_minus_base": gained, "episodes": options.episodes}
        options.json.write_text(json.dumps(report, indent=2))
