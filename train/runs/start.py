"""The beginning of a run: everything that can be checked is checked, then its directory is claimed."""

from pathlib import Path
from typing import IO, NamedTuple

from medjax.errors import InputError
from medjax.wrappers import prepare_cpu
from train.algorithms.networks import build_network
from train.algorithms.ppo.learner import TrainState, make_train
from train.arguments import Request, make_environment
from train.runs.checkpoint import Checkpoints, updates_done
from train.runs.processes import is_first, join, together
from train.runs.run_directory import RunDir, check_unused, new_run_dir
from train.runs.session import Session, shapes_of


def open_session(request: Request) -> Session:
    """Checks everything that can be checked without compiling, then claims the directory.

    Raises:
        InputError: bad input; nothing was written.
    """
    config = request.config
    prepare_cpu()
    join(request.processes)
    together(lambda: _look(request.run_dir))
    env, params = make_environment(config)
    build_network(env, config)
    programs = make_train(env, params, config)
    shapes = shapes_of(programs, params, config)
    taken = together(lambda: _take(request, shapes))
    return Session(env, params, config, programs, shapes, request.resume is not None, *taken)


def _look(run_dir: Path | None) -> None:
    if run_dir is not None and is_first():
        check_unused(run_dir)


class _Taken(NamedTuple):
    """See `Session`."""

    run_dir: RunDir
    lock: IO[str] | None
    saved: TrainState | None


def _take(request: Request, shapes: TrainState) -> _Taken:
    """The directory and the checkpoint in it to go on from; only the first process locks and writes."""
    config = request.config
    if request.resume is None:
        if not is_first():
            return _Taken(RunDir(request.run_dir or Path()), None, None)
        run_dir = RunDir(request.run_dir or new_run_dir(config.scenario))
        return _Taken(run_dir, run_dir.claim(config), None)
    run_dir, checkpoints = RunDir(request.resume), Checkpoints(request.resume)
    lock = run_dir.lock() if is_first() else None
    saved = checkpoints.restore(shapes) if checkpoints.latest() is not None else None
    done = updates_done(saved) if saved is not None else 0
    if done >= config.num_updates:
        steps = done * config.steps_per_update
        raise InputError(
            f"run {run_dir.path} has done its {steps} decisions, allowed: --total-timesteps above {steps}"
        )
    if is_first():
        run_dir.update_config(config, done)
    return _Taken(run_dir, lock, saved)
