"""`python -m benchmarks.sweep --vary lr=3e-4,1e-3 --seeds 4`: settings and seeds of PPO, side by side in one program.

Every combination of the varied settings trains with every seed, each as `python -m train.ppo --num-seeds` trains it.
One program compiles for all of them: a GPU runs the learners at once, a CPU one after the other. All policies then
play the same episodes. Statistics over seeds are those of rliable (Agarwal et al. 2021, arXiv:2108.13264). Further
options are those of train.ppo.
"""

import argparse
import copy
import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from tqdm import tqdm

from benchmarks.command import add_plot, benchmark_parser, run_command
from benchmarks.studies.sweep_tables import LEARNER, describe, other_rows, plot, table
from medjax.episodes.scores import Evaluation, Scores, evaluate_policies
from medjax.errors import InputError, shown
from medjax.numerics.compilation import enable_compilation_cache
from medjax.numerics.rows import in_blocks
from medjax.policies.team import rules_of
from train.algorithms.environments import check_environment, make_environment
from train.algorithms.networks import PolicyWeights
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import shardings
from train.algorithms.registry import algorithm_of
from train.evaluation.statistics import plain
from train.evaluation.tables import SAMPLED, START, format_rows
from train.runs.arguments import add_settings, settings_from_text
from train.settings import from_json, to_json

# Settings that the program computes with. Others fix shapes or choose code, and would need a program of their own.
VARIED = (
    "learning_rate",
    "gamma",
    "gae_lambda",
    "clip_epsilon",
    "entropy_coef",
    "value_coef",
    "max_grad_norm",
    "sharpening",
)
UNUSED = ("checkpoint_interval", "keep_checkpoints", "updates_per_call", "force")
Numbers = dict[str, float]  # varied settings by name


class Learned(NamedTuple):
    """All learners; leading axes are those of settings and seeds."""

    weights: PolicyWeights
    start: PolicyWeights  # initial weights, (seeds, ...)
    curve: (
        np.ndarray
    )  # (updates, settings, seeds) mean return of the episodes that ended; not finite without any


def read_vary(texts: Sequence[str]) -> dict[str, list[float]]:
    """The values of each varied setting, from texts such as `lr=3e-4,1e-3`.

    Raises:
      InputError: no text, a setting that cannot vary, one that is named twice, or values that are not numbers.
    """
    fields = {field.name: field for field in dataclasses.fields(PPOConfig)}
    names = {flag.strip("-"): name for name in fields for flag in fields[name].metadata["flags"]}
    found: dict[str, list[float]] = {}
    for text in texts:
        given, _, values = text.partition("=")
        name = names.get(given, given.replace("-", "_"))
        if name not in VARIED:
            raise InputError(f"--vary {shown(given)}: allowed {', '.join(VARIED)}")
        if name in found:
            raise InputError(f"--vary {given} is given twice, allowed: once, with all its values")
        each = [settings_from_text(PPOConfig, {name: value})[name] for value in values.split(",")]
        if not all(isinstance(value, float) for value in each):
            raise InputError(f"--vary {shown(text)}: allowed NAME=NUMBER,NUMBER,...")
        found[name] = each
    if not found:
        raise InputError("no --vary, allowed: at least one")
    return found


def combinations(config: PPOConfig, varied: Mapping[str, Sequence[float]]) -> list[Numbers]:
    """All combinations, without repetitions; that of `config`, the default, comes first.

    Raises:
      InputError: a value out of its range.
    """
    default = {name: getattr(config, name) for name in varied}
    rows = [
        default,
        *(dict(zip(varied, values, strict=True)) for values in itertools.product(*varied.values())),
    ]
    checked = [dataclasses.replace(config, **row) for row in rows]
    found = [{name: getattr(each, name) for name in varied} for each in checked]
    return [row for number, row in enumerate(found) if row not in found[:number]]


def with_numbers(config: PPOConfig, numbers: Mapping[str, Any]) -> PPOConfig:
    """The settings with numbers that may be traced, which their checks could not read."""
    changed = copy.copy(config)
    for name, value in numbers.items():
        object.__setattr__(changed, name, value)
    return changed


def learn(env: Any, params: Any, config: PPOConfig, rows: Sequence[Numbers]) -> Learned:
    """Trains a learner for each row of numbers and each of `config.num_seeds` seeds."""
    build, seeds = algorithm_of(config).build_learner, config.num_seeds
    base: Any = build(env, params, config)
    keys = jax.random.key(config.seed)
    keys = jax.random.split(keys, seeds) if seeds > 1 else keys[None]
    # Learners in a row: all seeds of the first numbers, then all of the second.
    numbers = {
        name: jnp.repeat(jnp.asarray([row[name] for row in rows], jnp.float32), seeds)
        for name in rows[0]
    }

    def first(keys: jax.Array, traced: Any) -> Any:
        states = lax.map(lambda key: base.init(key, traced), keys)
        return jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(rows)), states)

    def update(states: Any, numbers: Mapping[str, jax.Array], traced: Any) -> Any:
        def one(state: Any, own: Mapping[str, jax.Array]) -> Any:
            # Building reads the length of an episode, which must not be traced.
            learner = build(env, params, with_numbers(config, own))
            state, metrics = learner.update(state, traced)
            return state, metrics["episode_return"]

        # On a CPU the environments of one learner fill the cache.
        return in_blocks(lambda some: jax.vmap(one)(*some), (states, numbers), rows_at_once=1)

    where = shardings(base, seeds=True)
    init = jax.jit(first, out_shardings=where)
    run = jax.jit(update, in_shardings=(where, None, None), donate_argnums=0)
    states = init(keys, params)
    start = jax.device_get(jax.tree.map(lambda leaf: leaf[:seeds], states.weights))
    curve = []
    for _ in tqdm(range(config.num_updates), "training", disable=None, leave=False):
        states, returns = jax.block_until_ready(run(states, numbers, params))
        curve.append(jax.device_get(returns))
    split = lambda leaf: leaf.reshape(len(rows), seeds, *leaf.shape[1:])  # noqa: E731
    weights = jax.tree.map(split, jax.device_get(states.weights))
    return Learned(weights, start, np.reshape(curve, (-1, len(rows), seeds)))


def play(
    env: Any, params: Any, config: PPOConfig, learned: Learned
) -> tuple[dict[str, list[list[Scores]]], dict[str, Scores]]:
    """Scores of every learner by way of playing and `[setting][seed]`, and of the start and the rules by name."""
    algorithm = algorithm_of(config)
    make = partial(algorithm.policy, env, config)
    ways = {LEARNER: False, LEARNER + SAMPLED: True}
    count, seeds = learned.curve.shape[1:]

    def own(tree: PolicyWeights, *index: int) -> PolicyWeights:
        return jax.tree.map(lambda leaf: leaf[index], tree)

    begin = own(learned.start, 0)
    others = {START: make(begin), START + SAMPLED: make(begin, stochastic=True), **rules_of(env)}
    episodes = config.eval_episodes
    first = {name: make(own(learned.weights, 0, 0), stochastic=way) for name, way in ways.items()}
    evaluation = Evaluation(env, params, first, episodes)
    found: dict[str, list[list[Scores]]] = {name: [[] for _ in range(count)] for name in ways}
    pairs = list(itertools.product(range(count), range(seeds)))
    for setting, seed in tqdm(pairs, "learners", disable=None, leave=False):
        weights = own(learned.weights, setting, seed)
        policies = {name: policy.replace(weights=weights) for name, policy in first.items()}
        for name, score in evaluation.play(policies, config.seed).items():
            found[name][setting].append(score)
    return found, evaluate_policies(env, params, others, episodes, config.seed)


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Trains, plays, prints the tables, and returns the report.

    Raises:
      InputError: a setting that is not allowed.
    """
    names = {field.name for field in dataclasses.fields(PPOConfig)}
    given = {name: value for name, value in vars(options).items() if name in names}
    usual = to_json(PPOConfig(eval_episodes=256))
    config = from_json({**usual, **settings_from_text(PPOConfig, given)}, PPOConfig)
    if not config.eval_episodes:
        raise InputError("eval_episodes is 0, allowed: at least 2")
    rows = combinations(config, read_vary(options.vary))
    check_environment(config)
    env, params = make_environment(config)
    learned = learn(env, params, config, rows)
    played, others = play(env, params, config, learned)
    found = describe(rows, played, others, config.seed)
    decisions = config.num_updates * config.steps_per_update
    print(
        f"{len(rows)} settings x {config.num_seeds} seeds on {config.scenario}, {decisions:,} decisions each; "
        f"{config.eval_episodes} episodes, the same for all",
        format_rows(table(found)),
        "",
        format_rows(other_rows(others, config.seed)),
        sep="\n",
    )
    return {
        "scenario": config.scenario,
        "config": to_json(config),
        "decisions": decisions,
        "rows": found,
        "others": {name: float(score["return"].mean()) for name, score in others.items()},
        # (updates, settings, seeds); None where no episode ended
        "curve": [[list(map(plain, seeds)) for seeds in each] for each in learned.curve],
    }


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = benchmark_parser("sweep", __doc__)
    text = f"a setting and its values, e.g. lr=3e-4,1e-3; repeatable; one of {', '.join(VARIED)}"
    parser.add_argument("--vary", action="append", default=[], metavar="NAME=A,B", help=text)
    add_plot(parser, "the figure")
    add_settings(parser, PPOConfig, UNUSED)
    enable_compilation_cache()
    run_command(parser, run, arguments, plot)
