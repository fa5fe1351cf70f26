"""The commands' training and evaluation from Python: `from train.api import PPOConfig, evaluate, train`.

They are not in `train` itself because `train.evaluate` is the module of a command.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import medjax
from medjax.commandline import as_path
from medjax.env.wrapper import whole_number_of
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError, shown
from medjax.numerics.compilation import prepare_jax
from medjax.policies.given import as_policy
from medjax.policies.policy import Policy
from medjax.policies.team import rules_of
from train.algorithms.environments import check_given, described
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.registry import algorithm_of
from train.evaluation.comparison import Comparison
from train.evaluation.summary import summarize
from train.runs.arguments import Request
from train.runs.checkpoint import CHECKPOINTS
from train.runs.interrupts import StoppedError
from train.runs.logs import Row
from train.runs.open_session import open_session
from train.runs.policies import check_episodes, weights_by_name
from train.runs.run_directory import RunDir
from train.runs.trained_run import LIMITS
from train.settings import TrainConfig

__all__ = ["Comparison", "PPOConfig", "StoppedError", "TrainedRun", "evaluate", "train"]


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """The result of training.

    Attributes:
        policies: the policy of each training seed; the first has the algorithm's name, "ppo".
        rows: rows of metrics.jsonl, one dict per update; None stands for a missing number.
        run_dir: directory of the run, as the command leaves it.
        evaluation: closing evaluation, on the environment's own episodes; None without `eval_episodes`.
        env: a single environment.
        params: its parameters.
        config: settings of the run.
    """

    # A notebook does not show the fields that would fill pages.
    policies: dict[str, Policy] = dataclasses.field(repr=False)
    rows: list[Row] = dataclasses.field(repr=False)
    run_dir: Path
    evaluation: Comparison | None = dataclasses.field(repr=False)
    env: Any = dataclasses.field(repr=False)
    params: Any = dataclasses.field(repr=False)
    config: TrainConfig

    @property
    def policy(self) -> Policy:
        """The first seed's policy: `policy(key, obs, state, params).action` is its most probable action."""
        return self.policies[self.config.algorithm]


def train(
    env: Any = None,
    params: Any = None,
    config: TrainConfig | None = None,
    *,
    run_dir: str | Path | None = None,
    resume: str | Path | None = None,
    callback: Callable[[Row], object] | None = None,
    quiet: bool = False,
) -> TrainedRun:
    """Trains and evaluates a dispatcher, as `python -m train.ppo` does.

    Args:
        env: a preset's name, or a single environment, which may be wrapped or have your own reward terms; None takes
            the environment of the settings.
        params: parameters of `env`, if that is an environment.
        config: settings; None takes the defaults, or those of the resumed run. An environment in `env` overrides what
            they say about environments. Without a `rule_sharpness` a resumed run keeps its own.
        run_dir: new or empty directory for the results; None takes an unused one under `runs/`. If the settings cannot
            rebuild the environment, config.json says so, and the commands on runs refuse the directory.
        resume: directory of a run to resume, in place of `run_dir`; or one of its `checkpoints/N.npz` to resume from,
            which removes later ones.
        callback: called with each row of metrics.jsonl once it is written. An exception that it raises ends the run.
        quiet: hide the progress; the first line and the results are still printed.

    Raises:
        InputError: bad input; nothing was written.
        StoppedError: a number was no longer finite, or the directory could not be written; checkpoints remain.
        KeyboardInterrupt: Ctrl-C; the state was saved.
        SystemExit: SIGTERM, with code 143; the state was saved.
    """
    if run_dir is not None and resume is not None:
        raise InputError(f"run_dir is {shown(run_dir)} and resume {shown(resume)}, allowed: one")
    if callback is not None and not callable(callback):
        raise InputError(f"callback is {shown(callback)}, allowed: a function")
    new = None if run_dir is None else as_path("run_dir", run_dir)
    old, update = (None, None) if resume is None else _to_resume(resume)
    settings = _settings(config, old, given=env is not None and not isinstance(env, str))
    settings, given = _environment(env, params, settings)
    how: dict[str, Any] = {"given": given, "callback": callback, "quiet": quiet}
    session = open_session(Request(settings, new, old, from_update=update, **how))
    settings = session.config
    try:
        ended = session.train()
    except StoppedError as stopped:
        if stopped.code == 130:
            raise KeyboardInterrupt(str(stopped)) from None
        if stopped.code > 128:
            raise SystemExit(stopped.code) from None
        raise
    policies = {
        name: algorithm_of(settings).policy(ended.env, settings, own)
        for name, own in weights_by_name(settings, ended.weights).items()
    }
    where = ended.rows, ended.run_dir.path, ended.played
    return TrainedRun(policies, *where, ended.env, ended.params, settings)


def _to_resume(given: str | Path) -> tuple[Path, int | None]:
    """The directory of the run to resume, and the update of the checkpoint if one was given."""
    path = as_path("resume", given)
    if path.suffix != ".npz":
        return path, None
    if path.parent.name != CHECKPOINTS or not path.stem.isdecimal():
        allowed = f"a run's directory, or its {CHECKPOINTS}/N.npz"
        raise InputError(f"resume {shown(str(path))}: allowed {allowed}")
    return path.parent.parent, int(path.stem)


def _settings(config: TrainConfig | None, resume: Path | None, given: bool) -> TrainConfig:
    """The given settings, else those of the run to resume, else the defaults."""
    if config is None:
        return PPOConfig() if resume is None else RunDir(resume, given).load_config()
    if not isinstance(config, TrainConfig):
        raise InputError(f"config is {shown(config)}, allowed: settings, such as PPOConfig()")
    return config


def _environment(
    env: Any, params: Any, config: TrainConfig
) -> tuple[TrainConfig, tuple[Any, Any] | None]:
    """The settings updated for the environment, and the environment itself if they cannot rebuild it."""
    if env is None or isinstance(env, str):
        if isinstance(params, TrainConfig):
            kind = type(params).__name__
            raise InputError(f"params are {kind}: allowed config={kind}(...)")
        if params is not None:
            raise InputError("params without an environment, allowed: both, or a preset's name")
        scenario = config.scenario if env is None else env
        return dataclasses.replace(config, scenario=scenario), None
    settings, rebuilt = described(env, params, config)
    check_given(env, settings)
    return settings, None if rebuilt else (env, params)


def evaluate(
    env: Any = "paper",
    params: Any = None,
    policies: Mapping[str, Any] | Sequence[str] | None = None,
    *,
    baseline: str | None = None,
    episodes: int = 200,
    seed: int = 0,
    batch: int = 128,
) -> Comparison:
    """Plays the same episodes with every policy, as `python -m train.evaluate` does.

    It uses all cores if JAX has computed nothing before, or if `medjax.prepare_jax()` was called first.

    Args:
        env: a single environment, or a preset's name.
        params: its parameters.
        policies: policies by name, each anything that `medjax.policies.given.as_policy` takes: a policy, a function
            `act(key, obs, state, params)`, a rule's name, a file; or a list of rules' names; None takes every rule.
        baseline: policy or rule to compare the others with, episode by episode.
        episodes: whole episodes per policy.
        seed: selects the episodes, the same as in `train.evaluate`.
        batch: episodes of each policy played together.

    Returns:
        A comparison that prints as the command's table; its `rows()` suit pandas.

    Raises:
        InputError: an unknown policy, or one that does not fit the environment.
    """
    _check_numbers(episodes=episodes, seed=seed, batch=batch)
    prepare_jax(messages=False)
    world: TrainConfig = PPOConfig()
    if isinstance(env, str):
        if params is not None:
            raise InputError("params with a preset's name, allowed: an environment and its own")
        world = dataclasses.replace(world, scenario=env)
        env, params = medjax.make(env)
    else:
        world, _ = described(env, params, world)
    given = _by_name(policies, rules_of(env))
    if baseline is not None and baseline not in list(given):  # it may be unhashable
        if baseline not in (known := [*given, *rules_of(env)]):
            raise InputError(f"baseline {shown(baseline)}: allowed {', '.join(known)}")
        given[baseline] = baseline
    check_episodes(episodes, len(given))
    playing = {name: as_policy(env, policy) for name, policy in given.items()}
    scores = evaluate_policies(env, params, playing, episodes, seed, batch)
    result = summarize(scores, world.scenario, (), seed, world.changes, baseline)
    return Comparison(result, scores)


def _check_numbers(**given: Any) -> None:
    """Refuses (InputError) the numbers that the commands' options of the same names refuse."""
    for name, number in given.items():
        least, most = LIMITS[name]
        whole_number_of(name, number, least)
        if number > most:
            raise InputError(f"{name} is {shown(number)}, must be at most {most}")


def _by_name(
    policies: Mapping[str, Any] | Sequence[str] | None, rules: Mapping[str, Policy]
) -> dict[str, Any]:
    """The policies to play, by name."""
    policies = list(rules) if policies is None else policies
    listed = isinstance(policies, Mapping | Sequence) and not isinstance(policies, str)
    if not listed or not all(isinstance(name, str) for name in policies):
        raise InputError(f"policies are {shown(policies)}, allowed: by name, or a list of names")
    if not policies:
        raise InputError("policies are empty, allowed: at least one")
    return dict(policies) if isinstance(policies, Mapping) else {name: name for name in policies}
