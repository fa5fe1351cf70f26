"""`python -m benchmarks.planner`: what a dispatcher gains on a policy by planning with the simulator.

Every `--hold` decisions, if a MED may be sent, the planner plays futures of the state. The candidates are: the policy
goes on; no MED is sent for that long; or one MED is sent from one of the ramps and none after it. Afterwards the
policy decides again, to the end of the episode. All candidates share the keys of the futures, which are never the
episode's own. Candidates are halved (sequential halving, Karnin et al. 2013). If the last one still seems better than
the policy, the planner follows it: one step of policy improvement (rollout algorithms, Bertsekas and Castanon 1999).

With `--know-arrivals` the futures keep the episode's own arrivals, and draw only how vehicles drive. The gain is then
that of a planner who knows who comes when: what better forecasts of demand could be worth at most, by such planning.

Whole episodes would show the gain only by the hundreds. Instead, the advantages of the planner's choices over the
policy's are added up along its episodes; the expected sum is the difference of the returns (performance difference
lemma, Kakade and Langford 2002). Fresh futures measure each advantage, so the selection adds no bias.
"""

import argparse
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from benchmarks.command import add_number, episodes_parser, run_command, whole_number
from benchmarks.studies.base import add_run_dir, dispatcher_settings, estimate, load
from medjax.env.contract import Environment
from medjax.episodes.keys import RESET, episode_keys
from medjax.episodes.runner import EpisodeRunner, Episodes, episode_steps
from medjax.errors import InputError
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from medjax.traffic.arrivals import redraw

AS_BASE = -1  # the plan to go on with the policy
ROLLOUT_SALT = 0xF07  # folded into the seed's key, so that no future is an evaluated episode


class PlanChoice(NamedTuple):
    """The planner's choice in one state."""

    plan: int  # the action, or AS_BASE if the policy goes on
    gain: float  # advantage over the policy, in futures that did not select it; 0 if the policy goes on
    gain_std: float  # standard deviation of the advantage over futures; NaN if the policy goes on


class Rollouts:
    """Plays futures of a state, compiled at the first call.

    Args:
        env: a single environment.
        params: its parameters.
        base: the policy.
        plan_length: of a candidate, in decisions.
        rows: futures played at once, divided among the candidates.
        know_arrivals: whether futures keep the arrivals of the state's episode.
    """

    def __init__(
        self,
        env: Environment,
        params: Any,
        base: Policy,
        plan_length: int,
        rows: int,
        know_arrivals: bool = False,
    ) -> None:
        self.runner, self.steps = EpisodeRunner(env, [base]), episode_steps(env, params)
        self._plan_length, self._rows = plan_length, rows
        self._know_arrivals = know_arrivals
        self.same = base.weights, params

        def to_end(rows: Any, same: Any) -> jax.Array:
            """Returns of whole episodes that are played on from the state."""
            first, steps, same = same
            return self.follow(rows, first, steps, same).scores["return"]

        self._to_end = jax.jit(on_devices(environment_mesh(rows), to_end))
        self._branch = jax.jit(self._branched)

    def follow(self, rows: Any, first: Any, last: Any, same: Any) -> Episodes:
        """Plays episodes on: first by their plans, then by the policy.

        Args:
            rows: the episodes so far, and the plan of each, (rows,) int32: AS_BASE, or an action that is taken
                once and followed by action 0 for the rest of the plan.
            first: () int32, the decision at which the plans start.
            last: the decision to stop before.
            same: `Rollouts.same`, the policy's weights and the environment's parameters.
        """
        (played, plans), (weights, params) = rows, same

        def decide(number: jax.Array, played: Episodes) -> Episodes:
            choice = self.runner.choose(played, number, [weights], params)
            follows = (plans == AS_BASE) | (number >= first + self._plan_length)
            own = jnp.where(number == first, plans, 0)
            held = choice._replace(action=jnp.where(follows, choice.action, own))
            return self.runner.go_on(played, number, held, params)[0]

        return lax.fori_loop(first, last, decide, played)

    def _branched(self, key: jax.Array, played: Episodes, each: jax.Array, params: Any) -> Episodes:
        """Copies an episode `rows` times; each copy continues in the future numbered by `each` (rows,)."""
        keys = jax.vmap(jax.random.fold_in, (None, 0))(key, each)
        streams = jax.vmap(jax.random.split, (0, None))(keys, 3)
        same = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (self._rows, *leaf.shape)), played)
        played = same.replace(streams=streams)
        if self._know_arrivals:
            return played
        env = self.runner.env

        def other_arrivals(key: jax.Array, state: Any) -> Any:
            return redraw(key, state, env.config, env.highway(state, params)[1])

        return played.replace(state=jax.vmap(other_arrivals)(streams[:, RESET], same.state))

    def returns(
        self, key: jax.Array, played: Episodes, first: int, candidates: list[int]
    ) -> np.ndarray:
        """Returns `(futures, candidates)`, with the same futures for all candidates.

        Args:
            key: of the futures.
            played: one episode, whose leaves have no axis of rows.
            first: its next decision.
            candidates: plans as in `follow`.
        """
        count = len(candidates)
        each = jnp.arange(self._rows) // count
        plans = jnp.asarray(np.resize(candidates, self._rows), jnp.int32)
        same = jnp.int32(first), jnp.int32(self.steps), self.same
        returns = self._to_end((self._branch(key, played, each, self.same[1]), plans), same)
        futures = self._rows // count
        return np.asarray(returns, np.float64)[: futures * count].reshape(futures, count)

    def select_plan(
        self, key: jax.Array, played: Episodes, first: int, num_actions: int
    ) -> PlanChoice:
        """The candidate that remains after halving, and its gain."""
        others, total, futures, number = np.arange(num_actions), np.zeros(num_actions), 0, 0
        while len(others):
            returns = self.returns(
                jax.random.fold_in(key, number), played, first, [AS_BASE, *others]
            )
            gains = returns[:, 1:] - returns[:, :1]
            if futures and len(others) == 1:
                return PlanChoice(int(others[0]), float(gains.mean()), float(gains.std(ddof=1)))
            total[others] += gains.sum(axis=0)
            futures, number = futures + len(gains), number + 1
            better = others[np.argsort(-total[others])][: max(len(others) // 2, 1)]
            others = better[total[better] > 0.0] if len(better) == 1 else better
        return PlanChoice(AS_BASE, 0.0, math.nan)


class Played(NamedTuple):
    """Results of some episodes."""

    returns: np.ndarray  # (episodes,) of the planner
    policy_returns: np.ndarray  # (episodes,) of the policy in the same episodes
    choices: list[list[PlanChoice]]  # by episode, the planner's choices


def play(env: Environment, params: Any, policy: Policy, options: argparse.Namespace) -> Played:
    """Plays episodes with the planner and with the policy alone; `options` are the command's."""
    plan_length, episodes = options.hold, options.episodes
    rollouts = Rollouts(env, params, policy, plan_length, options.futures, options.know_arrivals)
    root = jax.random.fold_in(jax.random.key(options.seed), ROLLOUT_SALT)
    mask = jax.jit(jax.vmap(env.action_mask, (0, None)))

    @jax.jit
    def go_on(rows: tuple[Episodes, jax.Array], first: jax.Array, same: Any) -> Episodes:
        """Follows the plans up to the next state in which the planner is asked."""
        return rollouts.follow(rows, first, first + plan_length, same)

    start = jax.jit(rollouts.runner.start)
    alone = played = start(episode_keys(options.seed, episodes), params)
    choices: list[list[PlanChoice]] = [[] for _ in range(episodes)]
    for first in tqdm(range(0, rollouts.steps, plan_length), "planning", disable=None, leave=False):
        plans = np.full(episodes, AS_BASE, np.int32)
        for episode in np.flatnonzero(np.asarray(mask(played.state, params))[:, 1:].any(axis=1)):
            one = jax.tree.map(lambda leaf, row=int(episode): leaf[row], played)
            key = jax.random.fold_in(jax.random.fold_in(root, episode), first)
            choices[episode].append(rollouts.select_plan(key, one, first, env.num_actions))
            plans[episode] = choices[episode][-1].plan
        same = jnp.int32(first), rollouts.same
        played = go_on((played, jnp.asarray(plans)), *same)
        alone = go_on((alone, jnp.full(episodes, AS_BASE, jnp.int32)), *same)
    ours, theirs = (np.asarray(each.scores["return"], np.float64) for each in (played, alone))
    return Played(ours, theirs, choices)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the planner's gain on the policy.

    Raises:
      InputError: the run cannot be read or is of agents, or --base is given too.
    """
    if options.run_dir and options.base:
        raise InputError(f"--base is {options.base} with --run-dir, allowed: one of the two")
    config, seed = dispatcher_settings(options), options.seed
    env, params, policies = load(options, config)
    name = config.algorithm if options.run_dir else options.base or "budgeted"
    played = play(env, params, policies[name], options)
    episodes = len(played.choices)
    gains = np.array([sum(each.gain for each in states) for states in played.choices])
    leaves = [each for states in played.choices for each in states if each.plan != AS_BASE]
    gain_std = float(np.sqrt(np.mean([each.gain_std**2 for each in leaves] or [math.nan])))
    asked, left = sum(map(len, played.choices)) / episodes, len(leaves) / episodes
    knows = "knows the arrivals and " if options.know_arrivals else ""
    print(
        f"{episodes} episodes of {config.scenario}, seed {seed}: "
        f"asked at {asked:.1f} states an episode, the planner {knows}leaves {name} at {left:.1f}"
    )
    shown = {
        "policy": name,
        "know_arrivals": options.know_arrivals,
        "asked": asked,
        "left": left,
        "spread": gain_std,
    }
    by_choices = "by its choices, in futures that did not make them"
    apart = played.returns - played.policy_returns
    for key, how, values in (("gain", by_choices, gains), ("apart", "by whole episodes", apart)):
        mean, (low, high) = estimate(values, seed).values()
        print(f"planner minus {name}, {how}: {mean:.2f} [{low:.2f}, {high:.2f}]")
        shown |= {f"{key}_mean": mean, f"{key}_ci95": [low, high]}
    if leaves:
        print(
            "a future with a choice and the same without differ by "
            f"{gain_std:.1f} (standard deviation)"
        )
    return shown


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("planner", __doc__, episodes=16, seed=0)
    add_run_dir(parser, "run whose first learner the study improves on")
    rule = "rule that the study improves on (default: budgeted)"
    parser.add_argument("--base", choices=sorted({*BASELINES} - {"slow"}), help=rule)
    at_once = "futures of a state played at once, shared among the candidates"
    add_number(parser, "--futures", 384, at_once, whole_number(least=12))
    add_number(parser, "--hold", 16, "decisions between two plans, for which a candidate holds")
    known = "plan with the episode's own arrivals, which no dispatcher knows"
    parser.add_argument("--know-arrivals", action="store_true", help=known)
    run_command(parser, measure, arguments)
