"""`python -m benchmarks.advantage`: what leaving a policy pays, wherever it would pay.

Episodes are played by the policy. Every `hold` decisions, where a MED may be sent, futures are played from there: the
policy goes on, nothing is sent for `hold` decisions, or a MED from one of the ramps and then nothing; behind that the
policy decides again, to the end of the episode. Futures are drawn by keys that the candidates share, and are never the
episode's own. The candidates are halved (sequential halving, Karnin et al. 2013), and the last one is played against
the policy in futures that chose nothing, so that no luck of the choice is counted.

What it pays, summed over an episode, is what one step of policy improvement (Bertsekas and Castanon 1999, rollout
algorithms) gives to first order, at the states that the policy comes to: neither a ceiling nor what a planner would
reach, but whether something is left to find, and how hard it is to see.
"""

import argparse
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from benchmarks.command import episodes_parser, positive, run_command, whole_number
from benchmarks.studies.base import add_base, follow, load
from medjax.env.contract import Environment
from medjax.episodes.keys import RESET, episode_keys
from medjax.episodes.player import Episodes, Player, episode_steps
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.policies.planner import AS_BASE
from medjax.policies.policy import Policy
from medjax.traffic.arrivals import redraw
from train.evaluation.statistics import bootstrap_ci95

FUTURES = 0xF07  # folded into the seed's key: no future is an episode that is evaluated


class Found(NamedTuple):
    """What is found of one state."""

    left: bool  # a candidate seemed better than the policy
    gain: float  # of it in futures that did not choose it; 0 where the policy goes on
    spread: float  # standard deviation of that difference from future to future, NaN where none was confirmed


class Futures:
    """Plays futures of a state, compiled when first asked.

    Args:
        env: a single environment.
        params: its parameters.
        base: the policy.
        hold: decisions for which a candidate stands.
        rows: futures played at once; candidates share them.
    """

    def __init__(self, env: Environment, params: Any, base: Policy, hold: int, rows: int) -> None:
        self.rows, self._same, self._steps = (
            rows,
            (base.weights, params),
            episode_steps(env, params),
        )
        player = Player(env, [base])

        def to_end(rows: Any, same: Any) -> jax.Array:
            """Returns from the state on, and what was had before."""
            first, steps, (weights, params) = same
            return follow(player, weights, rows, first, (steps, hold), params).scores["return"]

        self._to_end = jax.jit(on_devices(environment_mesh(rows), to_end))
        self._branch = jax.jit(self._branched)

    def _branched(self, key: jax.Array, played: Episodes, each: jax.Array) -> Episodes:
        """An episode `rows` times, each going on in the future of its number `each` (rows,)."""
        streams = jax.vmap(lambda number: jax.random.split(jax.random.fold_in(key, number), 3))(
            each
        )
        same = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (self.rows, *leaf.shape)), played)
        state = jax.vmap(redraw)(streams[:, RESET], same.state)
        return same.replace(streams=streams, state=state)

    def returns(
        self, key: jax.Array, played: Episodes, first: int, candidates: list[int]
    ) -> np.ndarray:
        """Returns `(futures, candidates)`, the same futures for each.

        Args:
            key: of the futures.
            played: one episode, leaves without an axis of rows.
            first: its next decision.
            candidates: as `medjax.policies.planner.look_ahead` says them.
        """
        count = len(candidates)
        each = jnp.arange(self.rows) // count
        plans = jnp.asarray(np.resize(candidates, self.rows), jnp.int32)
        same = jnp.int32(first), jnp.int32(self._steps), self._same
        returns = self._to_end((self._branch(key, played, each), plans), same)
        futures = self.rows // count
        return np.asarray(returns, np.float64)[: futures * count].reshape(futures, count)

    def find(self, key: jax.Array, played: Episodes, first: int, num_actions: int) -> Found:
        """The candidate that is left of all, and what it pays."""
        others, total, futures, number = np.arange(num_actions), np.zeros(num_actions), 0, 0
        while len(others):
            returns = self.returns(
                jax.random.fold_in(key, number), played, first, [AS_BASE, *others]
            )
            gains = returns[:, 1:] - returns[:, :1]
            if futures and len(others) == 1:
                return Found(True, float(gains.mean()), float(gains.std(ddof=1)))
            total[others] += gains.sum(axis=0)
            futures, number = futures + len(gains), number + 1
            better = others[np.argsort(-total[others])][: max(len(others) // 2, 1)]
            others = better[total[better] > 0.0] if len(better) == 1 else better
        return Found(False, 0.0, float("nan"))


def search(
    env: Environment, params: Any, policy: Policy, options: argparse.Namespace
) -> tuple[np.ndarray, list[list[Found]]]:
    """Returns of the policy's episodes (episodes,), and what is found of each state in which it may send."""
    hold, episodes = options.hold, options.episodes
    futures, player = Futures(env, params, policy, hold, options.futures), Player(env, [policy])
    nothing = jnp.full(episodes, AS_BASE, jnp.int32)

    @jax.jit
    def go_on(played: Episodes, first: jax.Array, weights: Any, params: Any) -> Episodes:
        """The policy itself, to the next state that is looked at."""
        return follow(player, weights, (played, nothing), first, (first + hold, hold), params)

    root = jax.random.fold_in(jax.random.key(options.seed), FUTURES)
    mask = jax.jit(jax.vmap(env.action_mask, (0, None)))
    played = jax.jit(player.start)(episode_keys(options.seed, episodes), params)
    found: list[list[Found]] = [[] for _ in range(episodes)]
    firsts = range(0, episode_steps(env, params), hold)
    for first in tqdm(firsts, "playing futures", disable=None, leave=False):
        for episode in np.flatnonzero(np.asarray(mask(played.state, params))[:, 1:].any(axis=1)):
            one = jax.tree.map(lambda leaf, row=int(episode): leaf[row], played)
            key = jax.random.fold_in(jax.random.fold_in(root, episode), first)
            found[episode].append(futures.find(key, one, first, env.num_actions))
        played = go_on(played, jnp.int32(first), policy.weights, params)
    return np.asarray(played.scores["return"], np.float64), found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints what leaving the policy pays.

    Raises:
      InputError: of `benchmarks.studies.base.load`.
    """
    scenario, env, params, name, policies = load(options)
    returns, found = search(env, params, policies[name], options)
    gains = np.array([sum(each.gain for each in states) for states in found])
    confirmed = [each for states in found for each in states if each.left]
    spread = float(np.sqrt(np.mean([each.spread**2 for each in confirmed] or [math.nan])))
    asked, left = sum(map(len, found)) / len(found), len(confirmed) / len(found)
    mean, (low, high) = float(gains.mean()), bootstrap_ci95(gains, options.seed)
    print(
        f"{len(found)} episodes of {scenario}, seed {options.seed}: {name} returns {returns.mean():.1f}"
    )
    print(f"asked at {asked:.1f} states an episode, leaving it seems better at {left:.1f}")
    print(
        f"which pays {mean:.2f} [{low:.2f}, {high:.2f}] an episode, in futures that did not choose it"
    )
    print(f"a future with it and the same without differ by {spread:.1f} (standard deviation)")
    shown = {"asked": asked, "left": left, "gain_mean": mean, "gain_ci95": [low, high]}
    return {"policy": name, "return_mean": float(returns.mean()), **shown, "spread": spread}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("advantage", __doc__, episodes=16, seed=0)
    add_base(parser)
    at_once = "futures of a state played at once, shared by the candidates (default %(default)s)"
    parser.add_argument("--futures", type=whole_number(least=12), default=384, help=at_once)
    between = (
        "decisions from state to state, and for which a candidate stands (default %(default)s)"
    )
    parser.add_argument("--hold", type=positive, default=16, metavar="N", help=between)
    run_command(parser, measure, arguments)
