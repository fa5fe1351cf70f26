"""`python -m benchmarks.sweep --vary lr=5e-4,2e-3 --seeds 4`: settings and seeds of PPO, side by side in one program.

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
from typing import Any

import jax
import jax.numpy as jnp
from tqdm import tqdm

from benchmarks.command import add_plot, benchmark_parser, run_command
from benchmarks.studies.ablation.side_by_side import Trained, train_learners
from benchmarks.studies.sweep_tables import LEARNER, describe, other_rows, plot, table
from medjax.episodes.runner import episode_decisions
from medjax.episodes.scores import Evaluation, Scores, evaluate_policies
from medjax.errors import InputError, shown
from medjax.numerics.compilation import enable_compilation_cache
from medjax.policies.policy import Policy
from medjax.policies.team import rules_of
from train.algorithms.environments import check_environment, make_environment
from train.algorithms.networks import PolicyWeights
from train.algorithms.policy_prior import starts_from_rule
from train.algorithms.ppo.settings import PPOConfig
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
    "rule_sharpness",
)
UNUSED = ("checkpoint_interval", "keep_checkpoints", "updates_per_call", "force")
Numbers = dict[str, float]  # varied settings by name


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


def with_settings(config: PPOConfig, numbers: Mapping[str, Any]) -> PPOConfig:
    """The settings with numbers that may be traced, which their checks could not read."""
    changed = copy.copy(config)
    for name, value in numbers.items():
        object.__setattr__(changed, name, value)
    return changed


def learn(env: Any, params: Any, config: PPOConfig, rows: Sequence[Numbers]) -> Trained:
    """Trains a learner for each row of numbers and each of `config.num_seeds` seeds.

    The axes of the weights begin with `(rows, seeds)`, those of the curve end with them, and `finite` has these alone.
    """
    config = config.for_episodes(episode_decisions(params))  # before its numbers are traced
    build, seeds = algorithm_of(config).build_learner, config.num_seeds
    keys = jax.random.key(config.seed)
    keys = jax.random.split(keys, seeds) if seeds > 1 else keys[None]
    # Learners in a row: all seeds of the first numbers, then all of the second.
    numbers = {
        name: jnp.repeat(jnp.asarray([row[name] for row in rows], jnp.float32), seeds)
        for name in rows[0]
    }
    weights, start, curve, finite = train_learners(
        # Building reads the length of an episode from params, which must not be traced.
        lambda own: build(env, params, with_settings(config, own)),
        lambda given, _: given,
        jnp.tile(keys, len(rows)),
        numbers,
        params,
        config.num_updates,
    )
    split = lambda leaf: leaf.reshape(len(rows), seeds, *leaf.shape[1:])  # noqa: E731
    weights, start = (jax.tree.map(split, jax.device_get(tree)) for tree in (weights, start))
    return Trained(
        weights, start, curve.reshape(-1, len(rows), seeds), finite.reshape(len(rows), seeds)
    )


def play(
    env: Any, params: Any, config: PPOConfig, rows: Sequence[Numbers], learned: Trained
) -> tuple[dict[str, list[list[Scores]]], dict[str, list[Scores]], dict[str, Scores]]:
    """Plays the same episodes with every learner, the first seed's initial policies, and the rules.

    Returns:
      Scores by name, most probable and sampled: of learners `[row][seed]`, of the initial policies `[row]`; and of the
      rules.
    """
    own_numbers: Sequence[Mapping[str, Any]] = rows
    configs = [dataclasses.replace(config, **own) for own in own_numbers]

    def ways(weights: PolicyWeights, row: int, seed: int) -> dict[str, Policy]:
        """One network, most probable and sampled."""
        own = jax.tree.map(lambda leaf: leaf[row, seed], weights)
        policy = partial(algorithm_of(config).policy, env, configs[row], own)
        return {LEARNER: policy(), LEARNER + SAMPLED: policy(stochastic=True)}

    found: dict[str, list[list[Scores]]] = {LEARNER: [], LEARNER + SAMPLED: []}
    starts: dict[str, list[Scores]] = {START: [], START + SAMPLED: []}
    # A network holds the rule that it starts from. So each sharpness of the rule has a program and a start.
    of_rules: dict[float, tuple[Evaluation, dict[str, Scores]]] = {}
    for row, own in enumerate(tqdm(configs, "settings", disable=None, leave=False)):
        learners = [ways(learned.weights, row, seed) for seed in range(learned.curve.shape[2])]
        if own.rule_sharpness not in of_rules:
            program = Evaluation(env, params, learners[0], config.eval_episodes)
            start = program.play(ways(learned.start, row, 0), config.seed)
            of_rules[own.rule_sharpness] = program, start
        program, start = of_rules[own.rule_sharpness]
        scores = [program.play(policies, config.seed) for policies in learners]
        for name, of_rows in found.items():
            of_rows.append([score[name] for score in scores])
        for name, of_starts in starts.items():
            of_starts.append(start[name.replace(START, LEARNER, 1)])
    if rules := rules_of(env):  # none for an environment of one's own
        of_env = env, params, rules, config.eval_episodes, config.seed
        return found, starts, evaluate_policies(*of_env)
    return found, starts, {}


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
    varied = read_vary(options.vary)
    combinations(config, varied)  # refuses before anything is compiled
    check_environment(config)
    env, params = make_environment(config)
    if "rule_sharpness" in varied and not starts_from_rule(env, config):
        raise InputError("--vary rule_sharpness: allowed where the first policy is the rule's")
    config = config.for_episodes(episode_decisions(params))
    rows = combinations(config, varied)
    learned = learn(env, params, config, rows)
    played, starts, rules = play(env, params, config, rows, learned)
    found = describe(rows, played, starts[START], config.seed)
    lost = (~learned.finite).sum(axis=1)
    for row, count in zip(found, lost, strict=True):
        row["not_finite"] = int(count)
    others = {name: of_rows[0] for name, of_rows in starts.items()} | rules
    decisions = config.num_updates * config.steps_per_update
    print(
        f"{len(rows)} settings x {config.num_seeds} seeds on {config.scenario}, {decisions:,} decisions each; "
        f"{config.eval_episodes} episodes, the same for all",
        format_rows(table(found)),
        "",
        format_rows(other_rows(others, config.seed)),
        *(
            f"{row['settings']}: {row['not_finite']} of {config.num_seeds} learners did not stay finite"
            for row in found
            if row["not_finite"]
        ),
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
    text = f"a setting and its values, e.g. lr=5e-4,2e-3; repeatable; one of {', '.join(VARIED)}"
    parser.add_argument("--vary", action="append", default=[], metavar="NAME=A,B", help=text)
    add_plot(parser, "the figure")
    add_settings(parser, PPOConfig, UNUSED)
    enable_compilation_cache()
    run_command(parser, run, arguments, plot)
