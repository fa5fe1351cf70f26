"""`python -m benchmarks.planner`: what a dispatcher that owns a simulator reaches, an upper reference.

`medjax.policies.look_ahead` plays every action forward with fresh noise and then a base rule, and leaves the rule where
that surely pays. The episodes are those that `python -m train.evaluate` plays for the same seed, so that returns of
both commands stand beside each other. Slow: for an episode it plays `samples * actions * decisions / hold / 2` others.
"""

from __future__ import annotations

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import medjax
from benchmarks.arguments import episodes_parser, positive, whole_number
from medjax.episodes import ACT, RESET, STEP, episode_keys
from medjax.metrics import episode_metrics
from medjax.policies import AS_BASE, BASELINES, Act, look_ahead
from medjax.wrappers import environment_mesh, on_devices, prepare_cpu
from train.bootstrap import bootstrap_ci95
from train.cli import OneLineParser
from train.evaluation import (
    Scores,
    baseline,
    evaluate_policies,
)

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
      seed: which episodes, as in `train.evaluation`.

    Returns:
      As `train.evaluation.Evaluation.play`, for one policy.
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


def build_parser() -> OneLineParser:
    """The command line."""
    parser = episodes_parser("planner", __doc__, episodes=16, seed=0)
    parser.add_argument(
        "--base", default="forecast", choices=list(BASELINES), help="what it improves on"
    )
    parser.add_argument(
        "--samples", type=whole_number(least=2), default=16, help="futures of each action"
    )
    parser.add_argument(
        "--hold", type=positive, default=16, metavar="N", help="decisions from plan to plan"
    )
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Prints the planner's, its base rule's and no action's scores."""
    options = build_parser().parse_args(arguments)
    prepare_cpu()
    env, params = medjax.make(options.scenario)
    base = BASELINES[options.base](env)
    plan = look_ahead(env, base, options.samples, options.hold)
    scores = {
        "planner": play_plans(env, params, plan, base, options.hold, options.episodes, options.seed)
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
