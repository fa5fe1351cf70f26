"""The start of a run: checks everything that can be checked, then claims the directory."""

import contextlib
import dataclasses
import math
from pathlib import Path
from typing import IO, Any

import jax

from medjax.episodes.duration import reckoned_time
from medjax.episodes.runner import episode_decisions
from medjax.errors import InputError, shown
from medjax.numerics.devices import prepare_cpu
from medjax.numerics.memory import GIGA, check_memory, tree_bytes
from medjax.policies.team import rules_of
from train.algorithms.algorithm import TrainState
from train.algorithms.environments import make_environment
from train.algorithms.programs import make_train, shapes_of
from train.option import filled
from train.runs.arguments import Request
from train.runs.checkpoint import Checkpoints, ShapeError, updates_done
from train.runs.logs import read_rows
from train.runs.policies import check_episodes, check_rule
from train.runs.processes import is_first, join, together
from train.runs.run_directory import RunDir, check_unused, new_run_dir
from train.runs.session import Session
from train.settings import TrainConfig, to_json

FLOAT = 4  # bytes
# With others, the same weights would be another policy; a run's initial policy is made anew from its seed.
OF_THE_POLICY = ("activation", "policy_prior", "rule_sharpness", "initial_wait", "seed")
NUMBERS_OF_A_CHOICE = 8  # in `train.algorithms.rollout.Trajectory`, besides observation and mask


def open_session(request: Request) -> Session:
    """Checks everything that can be checked without compiling, then claims the directory.

    Raises:
        InputError: bad input; nothing was written.
    """
    config = request.config
    prepare_cpu()
    join(request.processes)
    new = request.run_dir if is_first() else None
    together(lambda: check_unused(new) if new is not None else None)
    env, params = request.given or make_environment(config)
    if request.resume is not None:
        before = RunDir(request.resume, request.given is not None).load_config(type(config))
        check_rule(before, env, config)
        # The weights add to the rule of the resumed run. A longer run's default may be softer.
        config = filled(config, rule_sharpness=before.rule_sharpness)
    config = config.for_episodes(episode_decisions(params))
    request = dataclasses.replace(request, config=config)
    programs = make_train(env, params, config)
    shapes = shapes_of(programs, params, config)
    needed = _check_memory(env, params, config, shapes)
    taken = together(lambda: _take(request, shapes))
    resumed = request.resume is not None
    begun = env, params, config, programs, shapes, resumed, *taken
    left = config.num_updates - (updates_done(taken[-1]) if taken[-1] is not None else 0)
    each = getattr(env, "decisions_per_step", 1)  # only environments with a road have it
    decisions = left * config.steps_per_update * config.num_seeds * each
    takes = [f"{needed / GIGA:.2g} GB of memory or more", reckoned_time(env, decisions)]
    quiet = request.quiet or not is_first()
    return Session(*begun, ", ".join(filter(None, takes)), quiet, request.callback)


def _check_memory(env: Any, params: Any, config: TrainConfig, shapes: TrainState) -> float:
    """A low estimate of the bytes that a run takes; InputError if this machine cannot hold them.

    The state exists once on the devices and once on the host; gradients and their moments are as large as the weights.
    The rollout is counted once, although joining the blocks of a device's environments takes a second copy. The
    closing evaluation keeps its scores.
    """
    # The learned and the initial policy, most probable and sampled.
    policies = 2 * (config.num_seeds + 1) + len(rules_of(env))
    check_episodes(config.eval_episodes, policies, config.force, "eval_episodes")
    views = getattr(env, "num_agents", 1) * config.num_envs * config.choices_per_update
    seen = math.prod(env.observation_space(params).shape)
    rollout = views * (FLOAT * (seen + NUMBERS_OF_A_CHOICE) + env.num_actions)
    needed = 2 * tree_bytes(shapes) + rollout + 2 * tree_bytes(shapes.weights)
    if jax.process_count() == 1:
        what = f"num_envs {config.num_envs} x {config.choices_per_update} choices, num_seeds {config.num_seeds}"
        check_memory(f"{what}, hidden {' '.join(map(str, config.hidden))}", needed, config.force)
    return needed


def _take(request: Request, shapes: TrainState) -> tuple[RunDir, IO[str] | None, TrainState | None]:
    """The directory, its lock and the checkpoint to resume from; only the first process locks and writes."""
    config, own = request.config, request.given is not None
    if request.resume is None:
        if not is_first():
            return RunDir(request.run_dir or Path(), own), None, None
        run_dir = RunDir(request.run_dir or new_run_dir(config.scenario), own)
        return run_dir, run_dir.claim(config, made=request.run_dir is None), None
    run_dir, checkpoints = RunDir(request.resume, own), Checkpoints(request.resume)
    saved, update = None, request.from_update
    # A refusal releases the lock at once, even if a notebook keeps the error and its frames alive.
    with contextlib.ExitStack() as held:
        lock = held.enter_context(run_dir.lock()) if is_first() else None
        if update is not None:
            checkpoints.check(update)
        read_rows(run_dir.metrics)  # refuses a damaged file
        if checkpoints.latest() is not None:
            saved = _restored(run_dir.load_config(type(config)), checkpoints, request, shapes)
        elif run_dir.summary.exists() or run_dir.policy.exists():  # its rows would be lost
            what = f"run {run_dir.path} has results but no checkpoint to go on from"
            raise InputError(f"{what}, allowed: one with its checkpoints, or a new --run-dir")
        done = updates_done(saved) if saved is not None else 0
        if done >= config.num_updates:
            steps = done * config.steps_per_update
            what = f"run {run_dir.path} has done its {steps} decisions"
            raise InputError(f"{what}, allowed: --total-timesteps above {steps}")
        if is_first():
            run_dir.update_config(config, done)
            if checkpoints.remove_after(done):
                run_dir.remove_results()
        held.pop_all()
    return run_dir, lock, saved


def _restored(
    before: TrainConfig, checkpoints: Checkpoints, request: Request, shapes: TrainState
) -> TrainState:
    """The checkpoint to resume from; if it does not fit, the error names the settings that were changed."""
    # Older runs kept 0 for a rollout of an episode of `paper`, whatever world they were in.
    before = before.for_episodes(before.choices_per_update * before.decide_every)
    # Progress is counted in updates, which must stay alike, and the weights must remain the same policy.
    for name in (*request.config.of_an_update, *OF_THE_POLICY):
        given, kept = getattr(request.config, name), getattr(before, name)
        if given != kept:
            raise InputError(f"{name} {given}, which was {kept} until now, allowed: {kept}")
    try:
        return checkpoints.restore(shapes, request.from_update)
    except ShapeError as error:
        was = to_json(before)
        changed = [
            f"{name} {shown(value)}, which was {shown(was[name])}"
            for name, value in to_json(request.config).items()
            if value != was[name] and name != "total_timesteps"
        ]
        raise InputError(f"{', '.join(changed) or 'other code'}: {error}") from None
