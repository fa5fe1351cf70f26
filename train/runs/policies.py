"""The policies of a run: the learned ones, from its checkpoints and as a file, and the rules beside them."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
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
from medjax.policies.given import FILE, as_policy, check_policy
from medjax.policies.policy import Policy
from medjax.policies.saved import load_policy, save_policy
from medjax.policies.team import rules_of
from train.algorithms.environments import described, make_environment
from train.algorithms.networks import PolicyWeights, apply_policy
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.registry import algorithm_of
from train.evaluation.tables import START
from train.runs.checkpoint import Checkpoints
from train.runs.run_directory import RunDir
from train.settings import TrainConfig

PLATFORMS = ("cpu", "cuda", "tpu")  # supported by a policy's file
BYTES_OF_AN_EPISODE = 500  # the scores of one episode of one policy


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
    _check_fits(run_dir, env, params, config)
    return env, params, reader.restore_weights(weight_shapes(env, params, config))


def _check_fits(run_dir: Path, env: Any, params: Any, config: TrainConfig) -> None:
    """Refuses (InputError) an environment with other numbers of features or actions than the training had.

    Args:
        run_dir: directory of the run.
        env: single environment to play in.
        params: its parameters.
        config: settings that name `env` and `params`.
    """
    own = RunDir(run_dir).load_config()
    if (own.scenario, own.overrides) == (config.scenario, config.overrides):
        return
    theirs, numbers = make_environment(dataclasses.replace(own, num_devices=config.num_devices))
    (here, changed), (there, usual) = _sizes(env, params), _sizes(theirs, numbers)
    if here == there:
        return
    if own.scenario != config.scenario:
        changed, usual = {"scenario": config.scenario}, {"scenario": own.scenario}
    names = [name for name in usual if changed.get(name) != usual[name]]
    now, then = (
        ", ".join(f"{name} {sizes.get(name)}" for name in names) for sizes in (changed, usual)
    )
    raise InputError(
        f"run {run_dir} is of another shape: with {now} there are {here[0]} features and {here[1]} actions, "
        f"allowed: {there[0]} and {there[1]}, as in its training with {then}"
    )


def _sizes(env: Any, params: Any) -> tuple[tuple[int, int], dict[str, Any]]:
    """The numbers of features and actions of a policy, and the highway's sizes that determine them."""
    config = getattr(env, "config", None)
    highway = vars(config) if dataclasses.is_dataclass(config) else {}
    return (math.prod(env.observation_space(params).shape), env.num_actions), highway


def weights_by_name(config: TrainConfig, weights: PolicyWeights) -> dict[str, PolicyWeights]:
    """The weights of each seed: the first has the algorithm's name, the others append `_seed2`, ...

    Args:
        config: settings of the run.
        weights: the run's weights, with a leading axis if it had several seeds.
    """
    if config.num_seeds == 1:
        return {config.algorithm: weights}
    return {
        config.algorithm + (f"_seed{i + 1}" if i else ""): jax.tree.map(itemgetter(i), weights)
        for i in range(config.num_seeds)
    }


def all_policies(
    env: Any, config: TrainConfig, weights: PolicyWeights, stochastic: bool = False
) -> dict[str, Policy]:
    """The trained policies, named as in `weights_by_name`, the first seed's initial policy (`START`), and every rule.

    Args:
        env: a single environment.
        config: settings of the run.
        weights: the run's weights, with a leading axis if it had several seeds.
        stochastic: sample the actions of the trained policies and of the initial one.
    """
    learn = algorithm_of(config)
    by_name = weights_by_name(config, weights) | {START: learn.start(env, config, weights)}
    learned = {name: learn.policy(env, config, own, stochastic) for name, own in by_name.items()}
    return learned | rules_of(env)


def load_policies(
    run_dir: Path, config: TrainConfig, stochastic: bool
) -> tuple[Any, Any, dict[str, Policy]]:
    """A single environment, its parameters, and `all_policies`; arguments and errors are those of `load_weights`."""
    env, params, weights = load_weights(run_dir, config)
    return env, params, all_policies(env, config, weights, stochastic)


def make_world(
    names: Sequence[str], scenario: str | None, overrides: Mapping[str, Any]
) -> tuple[Any, Any, TrainConfig]:
    """An environment for policies without a run: that of the first policy from a file, or a preset.

    Args:
        names: names of policies, as in `chosen`.
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
    file = next((name for name in names if name.endswith(FILE)), None)
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
    wanted = list(found) if names is None else list(names)
    wanted += [baseline] if baseline is not None and baseline not in wanted else []
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
    """Writes the trained policy as one file for `medjax.policies.saved.load_policy`.

    The file names the preset's own reward, whatever the reward in training was.

    Args:
        path: file to write, replaced.
        env: a single environment of the run.
        params: its parameters.
        config: settings of the run.
        weights: the run's weights; the first of several seeds is taken.
        card: how it was trained, `RunDir.card`; stored in the file.
        given: the environment is a user's own, and the file does not describe it.

    Raises:
        InputError: the file cannot describe the environment but has to.
        OSError: the file cannot be written.
    """
    by_rule = config.agents != "none" and config.dispatcher != "agents"
    dispatcher = config.dispatcher if by_rule else ""
    how = config.decide_every, config.algorithm, dispatcher
    if given or config.wrapper != "none":
        about = about_of_own(env, *how)
    elif config.reward != "preset":
        weights_of = "reward_weights"
        kept = {
            key: each for key, each in config.overrides.items() if not key.startswith(weights_of)
        }
        unpaid = dataclasses.replace(config, reward="preset", overrides=kept)
        env, params = make_environment(unpaid)
        about = about_of(env, params, *how)
    else:
        about = about_of(env, params, *how)
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
    about = dataclasses.replace(about, training=card)
    with _without_source_lines():
        exported = export.export(jax.jit(act), platforms=PLATFORMS)(*shapes)
    save_policy(path, about, exported)


@contextlib.contextmanager
def _without_source_lines() -> Iterator[None]:
    """A context in which programs contain no lines of source and no paths of this machine."""
    option = "jax_traceback_in_locations_limit"
    before = getattr(jax.config, option)
    jax.config.update(option, 0)
    try:
        yield
    finally:
        jax.config.update(option, before)


def check_episodes(
    episodes: int, policies: int, force: bool | None = None, option: str = "--episodes"
) -> None:
    """Refuses (InputError) episodes whose scores, of all policies, exceed this machine's memory."""
    check_memory(f"{option} {episodes}", episodes * policies * BYTES_OF_AN_EPISODE, force)
