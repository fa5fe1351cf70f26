"""Training and evaluation from Python, as the commands do them: `from train.api import PPOConfig, evaluate, train`.

They are here and not in `train` itself, where `train.evaluate` is the module of a command.
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
from train.evaluation.comparison import Comparison, check_known
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
    """What came of training.

    Attributes:
        policies: what each training seed learned; that of the first has the algorithm's name, "ppo".
        rows: of metrics.jsonl, a dict an update; None where there was no number.
        run_dir: directory of the run, as the command leaves it.
        evaluation: the closing one, on the environment's own episodes; None without `eval_episodes`.
        env: a single environment.
        params: its parameters.
        config: settings.
    """

    # What takes pages to write is left out of what a notebook shows.
    policies: dict[str, Policy] = dataclasses.field(repr=False)
    rows: list[Row] = dataclasses.field(repr=False)
    run_dir: Path
    evaluation: Comparison | None = dataclasses.field(repr=False)
    env: Any = dataclasses.field(repr=False)
    params: Any = dataclasses.field(repr=False)
    config: TrainConfig

    @property
    def policy(self) -> Policy:
        """What the first seed learned: `policy(key, obs, state, params).action` is the most probable action."""
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
        env: a preset's name; a single environment, with reward terms of one's own or wrapped as it may be; None: that
            of the settings.
        params: parameters of an environment that is given.
        config: settings; None: the defaults, or those of the run that is resumed. They say nothing of an environment
            that is given.
        run_dir: new or empty directory for the results; None: an unused one under `runs/`. Where settings cannot
            rebuild the environment, its config.json says so, and the commands on runs refuse it.
        resume: directory of a run to go on with, in place of run_dir; or one of its `checkpoints/N.npz`, to go on from
            there, which removes later ones.
        callback: gets each update's row of metrics.jsonl once it is written. What it raises ends the run.
        quiet: no progress is shown; a line where it begins and the results at the end are printed all the same.

    Raises:
        InputError: bad input; nothing was written.
        StoppedError: a number was no longer finite, or the directory could not be written; the newest checkpoint stays.
        KeyboardInterrupt: after Ctrl-C; the state is saved.
        SystemExit: after SIGTERM, with code 143; the state is saved.
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
    try:
        ended = session.train()
    except StoppedError as stopped:
        if stopped.code == 130:
            raise KeyboardInterrupt(str(stopped)) from None
        if stopped.code > 128:
            raise SystemExit(stopped.code) from None
        raise
    learn, by_name = algorithm_of(settings), weights_by_name(settings, ended.weights)
    policies = {name: learn.policy(ended.env, settings, own) for name, own in by_name.items()}
    where = ended.rows, ended.run_dir.path, ended.played
    return TrainedRun(policies, *where, ended.env, ended.params, settings)


def _to_resume(given: str | Path) -> tuple[Path, int | None]:
    """The directory of a run, and the update of the checkpoint that is given of it."""
    path = as_path("resume", given)
    if path.suffix != ".npz":
        return path, None
    if path.parent.name != CHECKPOINTS or not path.stem.isdecimal():
        allowed = f"a run's directory, or its {CHECKPOINTS}/N.npz"
        raise InputError(f"resume {shown(str(path))}: allowed {allowed}")
    return path.parent.parent, int(path.stem)


def _settings(config: TrainConfig | None, resume: Path | None, given: bool) -> TrainConfig:
    """Settings that are given, those of a run, or the defaults."""
    if config is not None and not isinstance(config, TrainConfig):
        raise InputError(f"config is {shown(config)}, allowed: settings, such as PPOConfig()")
    if config is not None or resume is None:
        return PPOConfig() if config is None else config
    return RunDir(resume, given).load_config()


def _environment(
    env: Any, params: Any, config: TrainConfig
) -> tuple[TrainConfig, tuple[Any, Any] | None]:
    """The settings with what they can say of the environment; and itself, where they do not rebuild it."""
    if env is None or isinstance(env, str):
        if isinstance(params, TrainConfig):
            raise InputError(
                f"params are {type(params).__name__}: allowed config={type(params).__name__}(...)"
            )
        if params is not None:
            raise InputError("params without an environment, allowed: both, or a preset's name")
        scenario = config.scenario if env is None else env
        return dataclasses.replace(config, scenario=scenario), None
    settings, rebuilt = _described(env, params, config)
    check_given(env, settings)
    return settings, None if rebuilt else (env, params)


def _described(env: Any, params: Any, config: TrainConfig) -> tuple[TrainConfig, bool]:
    """`described` of an environment that has parameters."""
    if params is None:
        raise InputError("env without params, allowed: both, as medjax.make gives them")
    return described(env, params, config)


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

    On all cores, where nothing was computed before or `medjax.prepare_jax()` was called first.

    Args:
        env: a single environment, or a preset's name.
        params: its parameters.
        policies: by name, whatever `medjax.policies.given.as_policy` takes: a policy, a function
            `act(key, obs, state, params)`, a rule's name, a file; or names of rules; None: every rule.
        baseline: one of them, or a rule, that the others are compared with, episode by episode.
        episodes: whole episodes of each policy.
        seed: which episodes; those of `train.evaluate` for the same seed.
        batch: episodes of each policy played together.

    Returns:
        Printed, the command's table; `rows()` are for pandas.

    Raises:
        InputError: an unknown policy, or an environment that it does not fit.
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
        world, _ = _described(env, params, world)
    given = _by_name(policies, rules_of(env))
    if baseline is not None and baseline not in list(given):  # which need not have a hash
        check_known("baseline", [baseline], [*given, *rules_of(env)])
        given[baseline] = baseline
    check_episodes(episodes, len(given))
    playing = {name: as_policy(env, policy) for name, policy in given.items()}
    scores = evaluate_policies(env, params, playing, episodes, seed, batch)
    result = summarize(scores, world.scenario, (), seed, world.changes, baseline)
    return Comparison(result, scores)


def _check_numbers(**given: Any) -> None:
    """Refuses (InputError) numbers by name, as Python has them, that the options of the commands refuse."""
    for name, number in given.items():
        least, most = LIMITS[name]
        whole_number_of(name, number, least)
        if number > most:
            raise InputError(f"{name} is {shown(number)}, must be at most {most}")


def _by_name(
    policies: Mapping[str, Any] | Sequence[str] | None, rules: Mapping[str, Policy]
) -> dict[str, Any]:
    """What is to be played, by name."""
    policies = list(rules) if policies is None else policies
    listed = isinstance(policies, Mapping | Sequence) and not isinstance(policies, str)
    if not listed or not all(isinstance(name, str) for name in policies):
        raise InputError(f"policies are {shown(policies)}, allowed: by name, or a list of names")
    given = dict(policies) if isinstance(policies, Mapping) else {name: name for name in policies}
    if not given:
        raise InputError("policies are empty, allowed: at least one")
    return given
