"""A training run as the host sees it: compile, drive chunks of updates, save, and close with an evaluation."""

import dataclasses
import signal
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp

from medjax.wrappers import prepare_cpu
from train.checkpoint import Checkpoints, updates_done
from train.cli import Request, make_environment
from train.closing import close_run, prepare_evaluation
from train.config import SettingError, TrainConfig
from train.evaluation import Evaluation
from train.host import Interrupt, deferred_interrupts, enable_compilation_cache
from train.learner import TrainFunctions, TrainState, make_train
from train.logs import MetricsLog, Progress, Row, rows_from
from train.networks import build_network
from train.rundir import RunDir, check_unused, unused_run_dir

# A program that runs once had better compile fast than run fast.
ONCE = {"xla_backend_optimization_level": 0}
SECONDS_PER_CALL = 1.0  # of the compiled program: how often the bar moves and Ctrl-C is heard


def open_session(request: Request) -> "Session":
    """Checks everything that can be checked without compiling, then claims the directory.

    Raises:
        SettingError: bad input; nothing was written.
    """
    config = request.config
    prepare_cpu()
    if request.resume is None and request.run_dir is not None:
        check_unused(request.run_dir)
    env, params = make_environment(config)
    try:
        build_network(env, config)
        programs = make_train(env, params, config)
    except ValueError as error:
        raise SettingError(str(error)) from None
    shapes = shapes_of(programs, params, config)
    run_dir = RunDir(request.resume or request.run_dir or unused_run_dir(config.scenario))
    session = Session(env, params, config, run_dir, programs, shapes, request.resume is not None)
    if session.resumed:
        done = session.checkpoints.check(shapes)
        if done >= config.num_updates:
            steps = done * config.steps_per_update
            raise SettingError(
                f"run {run_dir.path} has done its {steps} decisions, allowed: --total-timesteps above {steps}"
            )
        run_dir.update_config(config, done)
    else:
        run_dir.claim(config)
    return session


def shapes_of(programs: TrainFunctions, params: Any, config: TrainConfig) -> TrainState:
    """Shapes and types of the training state, found without computing or compiling it."""
    # Traced as it will be compiled, so that compiling need not trace it again.
    state = jax.eval_shape(programs.init, jax.random.key(config.seed), params)
    # They hold for any number of devices.
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state)


@dataclasses.dataclass
class Session:
    """One run, from `open_session` to its exit code.

    Attributes:
        env: a single environment.
        params: its parameters.
        config: settings.
        run_dir: where results go.
        programs: see `make_train`.
        shapes: shapes and types of the training state.
        resumed: goes on from a checkpoint.
    """

    env: Any
    params: Any
    config: TrainConfig
    run_dir: RunDir
    programs: TrainFunctions
    shapes: TrainState
    resumed: bool

    def __post_init__(self) -> None:
        """Starts the clock."""
        self.began = time.perf_counter()
        self.compile_s = self.train_s = 0.0
        self.checkpoints = Checkpoints(self.run_dir.path, self.config.keep_checkpoints)
        self.behind = ThreadPoolExecutor(1)
        self.evaluation: Future[Evaluation]

    def run(self) -> int:
        """Trains, saves and evaluates. Returns the exit code."""
        enable_compilation_cache()
        self._announce()
        done = self.checkpoints.latest() or 0
        progress = Progress(self.config, done, "compiling")
        try:
            init, run = self._compile()
        except KeyboardInterrupt:
            if not self.resumed:
                self.run_dir.release()
            return _interrupted(signal.SIGINT, "before the first update, nothing is left")
        finally:
            progress.close()
        log = MetricsLog(self.run_dir, done)
        earlier_s = log.rows[-1]["wall_s"] if log.rows else 0.0
        progress = Progress(self.config, done, "training")
        try:
            with deferred_interrupts() as interrupt:
                if self.resumed:
                    state = self.checkpoints.restore(self.shapes)
                    state = jax.device_put(state, self.programs.shardings)
                else:
                    state = init(jax.random.key(self.config.seed), self.params)
                state, healthy = self._drive(run, state, log, progress, interrupt, earlier_s)
        finally:
            progress.close()
            log.close()
        if not healthy:
            where = f"the newest checkpoint is of update {self.checkpoints.latest()}"
            print(f"the loss is no longer finite: stopped; {where}", file=sys.stderr)
            return 1
        return self._close(state, log.rows, updates_done(state) - done, earlier_s, interrupt.number)

    def _close(
        self,
        state: TrainState,
        rows: list[Row],
        new_updates: int,
        earlier_s: float,
        stopped_by: int | None,
    ) -> int:
        """Evaluates and reports; a run that was stopped is only reported. Returns the exit code."""
        self.checkpoints.close()
        wall_s = earlier_s + time.perf_counter() - self.began
        try:
            close_run(self, state, rows, new_updates, wall_s, evaluate=stopped_by is None)
        except KeyboardInterrupt:
            close_run(self, state, rows, new_updates, wall_s, evaluate=False)
            again = f"python -m train.evaluate --run-dir {self.run_dir.path}"
            return _interrupted(signal.SIGINT, f"after the last update; evaluate with: {again}")
        if stopped_by is None:
            return 0
        again = f"python -m train.ppo --resume {self.run_dir.path}"
        return _interrupted(
            stopped_by, f"after update {updates_done(state)}, saved; go on with: {again}"
        )

    def _announce(self) -> None:
        config, device = self.config, jax.devices()[0]
        seeds = f" x {config.num_seeds} seeds" if config.num_seeds > 1 else ""
        print(
            f"{'resuming' if self.resumed else 'training'} {config.scenario} in {self.run_dir.path}:"
            f" {config.num_updates} updates of {config.num_envs} x {config.rollout_length} choices{seeds},"
            f" {device.platform} {device.device_kind}",
            flush=True,
        )

    def _compile(self) -> tuple[Any, Any]:
        """The two programs, compiled ahead of time and side by side; `init` is None where it is not needed.

        The closing evaluation is compiled behind them, and on while training begins: XLA leaves a core idle for much of
        the time that it takes for one program.
        """
        start = time.perf_counter()
        init: Any = self.programs.init
        run: Any = self.programs.run
        waiting = None
        if not self.resumed:
            lowered = init.lower(jax.random.key(self.config.seed), self.params)
            waiting = self.behind.submit(lowered.compile, compiler_options=ONCE)
        lowered = run.lower(self.shapes, self.params, jnp.int32(1))
        if self.config.eval_episodes:
            self.evaluation = self.behind.submit(
                prepare_evaluation, self.env, self.params, self.config, self.shapes.weights
            )
        compiled = lowered.compile()
        ready = waiting.result() if waiting is not None else None
        self.compile_s = time.perf_counter() - start
        return ready, compiled

    def _drive(
        self,
        run: Any,
        state: TrainState,
        log: MetricsLog,
        progress: Progress,
        interrupt: Interrupt,
        earlier_s: float,
    ) -> tuple[TrainState, bool]:
        """Calls the program until all updates are done or a signal came; the last state is saved.

        Returns:
            The state, and False if its loss is not finite (it is not saved then).
        """
        config, started = self.config, time.perf_counter()
        done, per_update_s = updates_done(state), SECONDS_PER_CALL
        while done < config.num_updates and interrupt.number is None:
            count = self._chunk(done, per_update_s)
            called = time.perf_counter()
            state, metrics = run(state, self.params, jnp.int32(count))
            rows = rows_from(jax.device_get(metrics), count)
            now = time.perf_counter()
            per_update_s = (now - called) / count
            for index, row in enumerate(rows):
                since = called + (index + 1) * per_update_s
                rows[index] = {
                    "update": done + index + 1,
                    "env_steps": (done + index + 1) * config.steps_per_update * config.num_seeds,
                    "wall_s": round(earlier_s + since - self.began, 3),
                    "env_steps_per_s": config.steps_per_update * config.num_seeds / per_update_s,
                    **row,
                }
            done += count
            log.write(rows)
            progress.show(rows)
            if any(row["loss"] is None for row in rows):
                return state, False
            if config.checkpoint_interval and done % config.checkpoint_interval == 0:
                self.checkpoints.save(state)
        self.checkpoints.save(state)
        self.train_s = time.perf_counter() - started
        return state, True

    def _chunk(self, done: int, per_update_s: float) -> int:
        """Updates in the next call: about a second of them, not past the end or the next checkpoint."""
        config = self.config
        most = min(config.updates_per_call, config.num_updates - done)
        if config.checkpoint_interval:
            most = min(most, config.checkpoint_interval - done % config.checkpoint_interval)
        return max(1, min(most, int(SECONDS_PER_CALL / per_update_s)))


def _interrupted(number: int, what: str) -> int:
    print(f"interrupted {what}", file=sys.stderr)
    return 128 + number
