"""`python -m benchmarks.planner`: what a dispatcher that owns a simulator reaches, an upper reference.

`medjax.policies.planner.look_ahead` plays every action forward with fresh noise and then a base, a rule or a
learner, and leaves the base where that surely pays. The episodes are those that `python -m train.evaluate`
plays for the same seed, so that returns of both commands stand beside each other. Slow: for an episode it plays
`samples * actions * decisions / hold / 2` others.
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from benchmarks.command import episodes_parser, positive, run_command, whole_number
from benchmarks.studies.base import add_base, follow, load
from medjax.env.contract import Environment
from medjax.episodes.keys import ACT, episode_keys
from medjax.episodes.player import Episodes, Player, episode_steps
from medjax.episodes.scores import Scores, evaluate_policies
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.policies.planner import AS_BASE, Plan, look_ahead
from medjax.policies.policy import Policy
from train.evaluation.statistics import bootstrap_ci95

SHOWN = ("depleted_share", "mean_range_m", "mean_soc", "meds_dispatched")


def play_plans(
    env: Environment, params: Any, plan: Plan, base: Policy, hold: int, episodes: int, seed: int
) -> Scores:
    """Whole episodes, played together, of a planner that is asked at every `hold`-th decision.

    Args:
      env: a single environment.
      params: its parameters.
      plan: as `medjax.policies.planner.look_ahead` returns it.
      base: what is played where it says AS_BASE.
      hold, episodes: at least 1.
      seed: which episodes, as in `medjax.episodes.scores`.
    """
    mesh, player = environment_mesh(episodes), Player(env, [base])

    def ask(rows: Episodes, same: tuple[jax.Array, Any]) -> jax.Array:
        """What to hold; keys of their own stream, so that the futures that are tried are not what will happen."""
        number, params = same

        def one(row: tuple[jax.Array, Any]) -> jax.Array:
            key, state = jax.random.fold_in(row[0], number), row[1]
            can_send = jnp.any(env.action_mask(state, params)[1:])
            return lax.cond(can_send, lambda: plan(key, state, params), lambda: jnp.int32(AS_BASE))

        # One episode after the other: its futures fill the cache.
        return lax.map(one, (rows.streams[:, ACT], rows.state))

    def go_on(rows: tuple[Episodes, jax.Array], same: tuple[jax.Array, Any]) -> Episodes:
        """The decisions until the planner is asked again."""
        first, params = same
        return follow(player, base.weights, rows, first, (first + hold, hold), params)

    ask, go_on = jax.jit(on_devices(mesh, ask)), jax.jit(on_devices(mesh, go_on))
    played = jax.jit(player.start)(episode_keys(seed, episodes), params)
    firsts = range(0, episode_steps(env, params), hold)
    for first in tqdm(firsts, "planning", disable=None, leave=False):
        same = jnp.int32(first), params
        played = go_on((played, ask(played, same)), same)
    return {name: np.asarray(values, np.float64) for name, values in played.scores.items()}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the planner's, its base's and no action's scores.

    Raises:
      InputError: of `load`.
    """
    scenario, env, params, base, policies = load(options)
    hold, episodes, seed = options.hold, options.episodes, options.seed
    plan = look_ahead(env, policies[base], options.samples, hold)
    scores = {"planner": play_plans(env, params, plan, policies[base], hold, episodes, seed)}
    others = {name: policies[name] for name in dict.fromkeys([base, "slow", "none"])}
    scores |= evaluate_policies(env, params, others, episodes, seed)
    rows = {}
    print(f"{episodes} episodes of {scenario}, seed {seed}")
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
    gained = {"mean": float(gain.mean()), "ci95": [low, high]}
    return {"policies": rows, "planner_minus_base": gained, "episodes": episodes}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("planner", __doc__, episodes=16, seed=0)
    add_base(parser)
    add = parser.add_argument
    add("--samples", type=whole_number(least=2), default=16, help="futures of each action")
    add("--hold", type=positive, default=16, metavar="N", help="decisions from plan to plan")
    run_command(parser, measure, arguments)
