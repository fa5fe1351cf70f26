"""`python -m benchmarks.planner`: what a dispatcher that owns a simulator reaches, an upper reference.

`medjax.policies.look_ahead` plays every action forward with fresh noise, then a base rule, and takes the best one. Here
it decides every `--interval` decisions and waits in between. The episodes are those that `python -m train.evaluate`
plays for the same seed, so that returns of both commands stand beside each other. It is slow: for each decision it
simulates `actions * samples * horizon / interval` others.
"""

from __future__ import annotations

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import medjax
from benchmarks.arguments import episodes_parser, positive
from medjax.metrics import episode_metrics
from medjax.policies import BASELINES, Act, look_ahead
from medjax.wrappers import environment_mesh, on_devices, prepare_cpu
from train.bootstrap import bootstrap_ci95
from train.cli import OneLineParser
from train.evaluation import (
    ACT,
    RESET,
    STEP,
    Scores,
    baseline,
    episode_keys,
    evaluate_policies,
)

SHOWN = ("depleted_share", "mean_range_m", "mean_soc", "meds_dispatched")


def play_now_and_then(
    env: medjax.ChargingEnv, params: Any, act: Act, interval: int, episodes: int, seed: int
) -> Scores:
    """Whole episodes of a policy that is asked at every `interval`-th decision and else waits.

    Args:
      env: a single environment.
      params: its parameters.
      act: the policy.
      interval: at least 1.
      episodes: at least 1; all are played together.
      seed: which episodes, as in `train.evaluation`.

    Returns:
      As `train.evaluation.Evaluation.play`, for one policy.
    """
    mesh = environment_mesh(episodes)
    streams = jax.vmap(jax.random.split, (0, None))(episode_keys(seed, episodes), 3)

    def plan(rows: tuple[jax.Array, Any], same: tuple[jax.Array, Any]) -> jax.Array:
        """Actions; keys of their own stream, so that the futures that are tried are not what will happen."""
        (keys, states), (number, params) = rows, same
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, number)
        # One episode after the other: its futures fill the cache.
        return jax.lax.map(lambda row: act(row[0], row[1], params), (keys, states))

    def advance(rows: tuple[jax.Array, Any, jax.Array, jax.Array], params: Any) -> Any:
        """The decisions until the next question."""
        keys, states, totals, actions = rows

        def decide(
            state: Any, total: jax.Array, key: jax.Array, action: jax.Array
        ) -> tuple[Any, jax.Array]:
            live = state.time < params.episode_decisions
            key = jax.random.fold_in(key, state.time)
            _, after, reward, _, _, _ = env.step_env(key, state, action, params)
            state = jax.tree.map(lambda new, old: jnp.where(live, new, old), after, state)
            return state, total + jnp.where(live, reward, 0.0)

        def body(index: jax.Array, carry: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
            now = jnp.where(index == 0, actions, 0)
            return jax.vmap(decide)(*carry, keys, now)

        return jax.lax.fori_loop(0, interval, body, (states, totals))

    ask = jax.jit(on_devices(mesh, plan))
    go_on = jax.jit(on_devices(mesh, advance))
    _, states = jax.jit(jax.vmap(env.reset, (0, None)))(streams[:, RESET], params)
    totals = jnp.zeros((episodes,))
    asked = -(-int(params.episode_decisions) // interval)
    for number in tqdm(range(asked), "planning", disable=None, leave=False):
        actions = ask((streams[:, ACT], states), (jnp.int32(number), params))
        states, totals = go_on((streams[:, STEP], states, totals, actions), params)
    scores = {"return": totals, **jax.vmap(episode_metrics)(states.tally)}
    return {name: np.asarray(values, np.float64) for name, values in scores.items()}


def build_parser() -> OneLineParser:
    """The command line."""
    parser = episodes_parser("planner", __doc__, episodes=32, seed=0)
    parser.add_argument(
        "--base", default="paced", choices=list(BASELINES), help="what is played in the futures"
    )
    parser.add_argument("--samples", type=positive, default=8, help="futures of each action")
    parser.add_argument("--horizon", type=positive, default=240, metavar="S", help="s of a future")
    parser.add_argument(
        "--interval", type=positive, default=8, metavar="N", help="decisions from plan to plan"
    )
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Prints the planner's, its base rule's and no action's scores."""
    options = build_parser().parse_args(arguments)
    prepare_cpu()
    env, params = medjax.make(options.scenario)
    base = BASELINES[options.base](env)
    planner = look_ahead(env, base, options.samples, options.horizon)
    scores = {
        "planner": play_now_and_then(
            env, params, planner, options.interval, options.episodes, options.seed
        )
    }
    rules = {name: baseline(BASELINES[name](env)) for name in dict.fromkeys([options.base, "none"])}
    scores |= evaluate_policies(env, params, rules, options.episodes, options.seed)
    rows = {}
    print(f"{options.episodes} episodes of {options.scenario}, seed {options.seed}")
    print(f"{'policy':<10}{'return':>9}{'95 % CI':>20}" + "".join(f"{name:>17}" for name in SHOWN))
    for name, score in scores.items():
        low, high = bootstrap_ci95(score["return"])
        means = {metric: float(values.mean()) for metric, values in score.items()}
        rows[name] = means | {"return_ci95": [low, high]}
        shown = "".join(f"{means[metric]:17.3f}" for metric in SHOWN)
        print(f"{name:<10}{means['return']:9.1f}{f'[{low:.1f}, {high:.1f}]':>20}{shown}")
    gain = scores["planner"]["return"] - scores[options.base]["return"]
    low, high = bootstrap_ci95(gain)
    print(f"planner minus {options.base}: {gain.mean():.1f} [{low:.1f}, {high:.1f}]")
    if options.json:
        gained = {"mean": float(gain.mean()), "ci95": [low, high]}
        report = {"policies": rows, "planner_minus_base": gained, "episodes": options.episodes}
        options.json.write_text(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
