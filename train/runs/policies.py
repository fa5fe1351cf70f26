"""The policies of a run: the learned ones, from its checkpoints and as a file, and the rules beside them."""

import dataclasses
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import jax
from jax import export

import medjax
from medjax.errors import InputError
from medjax.numerics.devices import prepare_cpu
from medjax.numerics.memory import check_memory
from medjax.policies.about import about_of, about_of_own
from medjax.policies.given import as_policy, check_policy, file_of
from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES, budget_of, tuned_budget
from medjax.policies.saved import load_policy, save_policy
from medjax.policies.team import rules_of
from medjax.world.presets import SCENARIOS
from train.algorithms.environments import described, make_environment
from train.algorithms.networks import PolicyWeights, apply_policy
from train.algorithms.policy_prior import starts_from_rule
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.registry import algorithm_of
from train.evaluation.tables import SAMPLED, START
from train.runs.checkpoint import Checkpoints, ShapeError
from train.runs.run_directory import RunDir
from train.settings import TrainConfig

PLATFORMS = ("cpu", "cuda", "tpu")  # supported by a policy's file
BYTES_OF_AN_EPISODE = 500  # the scores of one episode of one policy
SOURCE_LINES = "jax_traceback_in_locations_limit"  # JAX's option


def weight_shapes(env: Any, params: Any, config: TrainConfig) -> PolicyWeights:
    """Shapes and types of a run's weights, with a leading axis for several seeds, without compiling anything."""
    shapes = algorithm_of(config).weight_shapes(env, params, config)
    seeds = (config.num_seeds,) if config.num_seeds > 1 else ()
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*seeds, *leaf.shape), leaf.dtype), shapes
    )


def load_weights(run_dir: Path, config: TrainConfig) -> tuple[Any, Any, PolicyWeights]:
    """A single environment, its parameters, and the newest weights of a run.

    Args:
        run_dir: directory of the run.
        config: its settings, or others with the same network.

    Raises:
        InputError: the environment cannot be made, or no checkpoint fits it.
    """
    prepare_cpu()
    reader = Checkpoints(run_dir)
    if reader.latest() is None:
        raise InputError(f"run {run_dir} holds no checkpoint, allowed: one that train.ppo wrote")
    env, params = make_environment(config)
    check_rule(RunDir(run_dir).load_config(), env, config)
    try:
        return env, params, reader.restore_weights(weight_shapes(env, params, config))
    except ShapeError as error:
        here, there = (
            " ".join([own.scenario, *(f"{name}={value}" for name, value in own.overrides.items())])
            for own in (config, RunDir(run_dir).load_config())
        )
        what = f"run {run_dir} is of another shape than {here}"
        allowed = f"features and actions as in its training on {there}"
        raise InputError(f"{what}, allowed: {allowed} ({error})") from None


def check_rule(before: TrainConfig, env: Any, config: TrainConfig) -> None:
    """Raises InputError if the weights of a run add to a rule that has other numbers in this environment.

    Args:
        before: settings of the run.
        env: a single environment to play or to go on in.
        config: settings that name it.
    """
    if before.scenario not in SCENARIOS or not starts_from_rule(env, config):
        return
    if budget_of(before.scenario) != tuned_budget(env):
        what = f"the run's weights add to the rule budgeted as tuned on {before.scenario}"
        raise InputError(
            f"scenario is {config.scenario!r}: {what}, allowed: a preset with the same numbers"
        )


def weights_by_name(config: TrainConfig, weights: PolicyWeights) -> dict[str, PolicyWeights]:
    """The weights of each seed: the first has the algorithm's name, the others append `_seed2`, ...

    Args:
        config: settings of the run.
        weights: the run's weights, with a leading axis if it had several seeds.
    """
    names = _names_of_seeds(config)
    if len(names) == 1:
        return {names[0]: weights}
    return {name: jax.tree.map(itemgetter(i), weights) for i, name in enumerate(names)}


def _names_of_seeds(config: TrainConfig) -> list[str]:
    first = config.algorithm
    return [first, *(f"{first}_seed{number}" for number in range(2, 1 + config.num_seeds))]


def check_names(config: TrainConfig, names: Sequence[str]) -> None:
    """Raises InputError for a name that is neither in `all_policies` nor one for `as_policy`; needs no environment."""
    learned = [name + end for name in (*_names_of_seeds(config), START) for end in ("", SAMPLED)]
    for name in names:
        if name not in learned:
            check_policy(name, [*learned, *BASELINES])


def all_policies(env: Any, config: TrainConfig, weights: PolicyWeights) -> dict[str, Policy]:
    """The trained policies, named as in `weights_by_name`, the first seed's initial policy (`START`), and every rule.

    Each network plays in two ways: it takes the most probable action, or it samples, and then its name ends in
    `SAMPLED`. Where the two differ, the policy that is played is not the one that was learned.

    Args:
        env: a single environment.
        config: settings of the run.
        weights: the run's weights, with a leading axis if it had several seeds.
    """
    learn = algorithm_of(config)
    by_name = weights_by_name(config, weights) | {START: learn.start(env, config, weights)}
    learned = {
        name + end: learn.policy(env, config, own, stochastic=bool(end))
        for name, own in by_name.items()
        for end in ("", SAMPLED)
    }
    return learned | rules_of(env)


def load_policies(run_dir: Path, config: TrainConfig) -> tuple[Any, Any, dict[str, Policy]]:
    """A single environment, its parameters, and `all_policies`; arguments and errors are those of `load_weights`."""
    env, params, weights = load_weights(run_dir, config)
    return env, params, all_policies(env, config, weights)


def make_world(
    names: Sequence[str], scenario: str | None, overrides: Mapping[str, Any]
) -> tuple[Any, Any, TrainConfig]:
    """An environment for policies without a run: that of the first policy from a file, or a preset.

    Args:
        names: names of policies, as in `chosen`, the baseline's among them.
        scenario: preset; None takes that of the file's training, or paper.
        overrides: numbers of the environment.

    Returns:
        The environment, its parameters, and settings that name it.

    Raises:
        InputError: an unknown name, or a number that the environment does not accept.
    """
    prepare_cpu()
    for name in names:
        check_policy(name)
    file = next(filter(None, map(file_of, names)), None)
    if file is not None:
        env, params = load_policy(file).make(scenario, overrides)
    else:
        env, params = medjax.make(scenario or "paper", **overrides)
    settings, _ = described(env, params, PPOConfig())
    return env, params, settings


def chosen(
    env: Any, found: Mapping[str, Policy], names: Sequence[str] | None, baseline: str | None
) -> dict[str, Policy]:
    """The policies to play, by name.

    Args:
        env: a single environment.
        found: policies of a run, and rules.
        names: names in `found`, or anything that `medjax.policies.given.as_policy` takes; None takes all of `found`.
        baseline: one more policy, if it is not among them.

    Raises:
        InputError: an unknown name.
    """
    wanted = dict.fromkeys(found if names is None else names)
    wanted |= {} if baseline is None else {baseline: None}
    known = dict.fromkeys([*found, *rules_of(env)])
    for name in wanted:
        if name not in found:
            check_policy(name, known)
    return {name: found[name] if name in found else as_policy(env, name) for name in wanted}


def export_policy(
    path: Path,
    env: Any,
    params: Any,
    config: TrainConfig,
    weights: PolicyWeights,
    card: Mapping[str, Any],
    given: bool = False,
) -> None:
    """Writes the trained policy of the first seed as one file for `medjax.policies.saved.load_policy`.

    The file names the preset's own reward, whatever the reward in training was.

    Args:
        path: file to write, replaced.
        env: a single environment of the run.
        params: its parameters.
        config: settings of the run.
        weights: the run's weights.
        card: how it was trained, `RunDir.card`; stored in the file.
        given: the environment is a user's own, and the file does not describe it.

    Raises:
        InputError: the file cannot describe the environment but has to.
    """
    by_rule = config.agents != "none" and config.dispatcher != "agents"
    how = config.decide_every, config.algorithm, config.dispatcher if by_rule else ""
    own_world = given or config.wrapper != "none"
    if not own_world and config.reward != "preset":
        numbers = config.overrides.items()
        kept = {name: value for name, value in numbers if not name.startswith("reward_weights")}
        unpaid = dataclasses.replace(config, reward="preset", overrides=kept)
        env, params = make_environment(unpaid)
    about = about_of_own(env, *how) if own_world else about_of(env, params, *how)
    network = algorithm_of(config).build_network(env, config)
    own = jax.device_get(weights_by_name(config, weights)[config.algorithm])

    def act(obs: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        policy, value = apply_policy(network, own, obs, mask)
        return policy.probs, value

    rows = export.symbolic_shape("rows")[0]
    shapes = (
        jax.ShapeDtypeStruct((rows, about.num_features), "float32"),
        jax.ShapeDtypeStruct((rows, about.num_actions), "bool"),
    )
    # The file holds no lines of source and no paths of this machine.
    before = getattr(jax.config, SOURCE_LINES)
    jax.config.update(SOURCE_LINES, 0)
    try:
        exported = export.export(jax.jit(act), platforms=PLATFORMS)(*shapes)
    finally:
        jax.config.update(SOURCE_LINES, before)
    save_policy(path, dataclasses.replace(about, training=card), exported)


def check_episodes(
    episodes: int, policies: int, force: bool | None = None, option: str = "--episodes"
) -> None:
    """Refuses (InputError) episodes whose scores, of all policies, exceed this machine's memory."""
    check_memory(f"{option} {episodes}", episodes * policies * BYTES_OF_AN_EPISODE, force)
