"""A training run on the host: it compiles, runs updates in chunks, saves, and closes with an evaluation."""

import contextlib
import dataclasses
import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import IO, Any

import jax
import jax.numpy as jnp

from medjax.commandline import signal_of
from medjax.episodes.runner import episode_decisions
from medjax.episodes.scores import Evaluation
from medjax.errors import one_line
from medjax.numerics.compilation import compiled, computed, enable_compilation_cache
from train.algorithms.algorithm import TrainState
from train.algorithms.finite import BAD, finite_updates
from train.algorithms.programs import Programs
from train.runs.checkpoint import Checkpoints, to_devices, to_host, updates_done
from train.runs.interrupts import Interrupt, StoppedError, deferred_interrupts
from train.runs.logs import MetricsLog, Progress, Row, rows_from
from train.runs.processes import agree, is_first, leave
from train.runs.results import Trained, prepare_evaluation, write_results
from train.runs.run_directory import RunDir
from train.settings import TrainConfig

# A program that runs once should compile fast rather than run fast.
ONCE: Any = {"xla_backend_optimization_level": 0}
SECONDS_PER_CALL = 1.0  # of the compiled program: how often the bar moves and Ctrl-C takes effect


@dataclasses.dataclass
class Session:
    """One run, from `train.runs.open_session` to its end."""

    env: Any  # a single environment
    params: Any  # its parameters
    config: TrainConfig
    programs: Programs
    shapes: TrainState  # shapes and types
    resumed: bool  # continues an earlier run
    run_dir: RunDir  # receives the results
    lock: IO[str] | None  # locks the directory while it is open; only the first process has it
    saved: TrainState | None  # checkpoint to resume from, on the host; None: train from the start
    takes: str  # memory and time, in words
    quiet: bool = False  # hide the progress
    callback: Callable[[Row], object] | None = None  # called with each update's row, once written

    def __post_init__(self) -> None:
        self.began = time.perf_counter()
        self.compile_s = self.train_s = self.earlier_s = 0.0
        self.done = updates_done(self.saved) if self.saved is not None else 0
        self.checkpoints = Checkpoints(self.run_dir.path, self.config.keep_checkpoints)
        self.behind = ThreadPoolExecutor(1)
        self.evaluation: Future[Evaluation] | None = None

    def run(self) -> int:
        """`train` as a command: prints on stderr why it stopped early. Returns the exit code."""
        try:
            self.train()
        except StoppedError as stopped:
            if stopped.code == 1 or is_first():
                print(stopped, file=sys.stderr)
            return leave(stopped.code) if stopped.alone else stopped.code
        return 0

    def train(self) -> Trained:
        """Trains, saves and evaluates.

        Raises:
            StoppedError: it stopped early, because of a signal, a number that is not finite, or a failed write.
        """
        try:
            return self._train()
        except KeyboardInterrupt as error:
            raise _interrupted(signal_of(error), f"at once; {self._newest()}") from None
        except OSError as error:
            reason = error.strerror or error
            raise self._stopped(f"cannot write {self.run_dir.path}: {reason}") from error
        except jax.errors.JaxRuntimeError as error:
            if jax.process_count() == 1:
                raise
            reason = str(error).partition("\n")[0][:100]
            raise self._stopped(f"another process ended ({reason})") from error
        finally:
            if self.lock is not None:
                self.lock.close()

    def _train(self) -> Trained:
        enable_compilation_cache()
        self._announce()
        try:
            with contextlib.closing(Progress(self.config, self.done, "compiling", self.quiet)):
                init, run = self._compile()
        except BaseException as error:  # a user's own environment may raise anything when traced
            if self.resumed:
                raise
            if self.lock is not None:  # this process claimed it
                self.run_dir.release()
            if not isinstance(error, KeyboardInterrupt):
                raise
            what = "before the first update, nothing is left"
            raise _interrupted(signal_of(error), what) from None
        log = MetricsLog(self.run_dir, self.done) if is_first() else None
        rows = log.rows if log else []
        self.earlier_s = rows[-1]["wall_s"] if rows else 0.0
        progress = Progress(self.config, self.done, "training", self.quiet)
        try:
            with deferred_interrupts() as interrupt:
                state, bad = self._drive(run, self._begin(init), log, progress, interrupt)
        finally:
            progress.close()
            if log:
                log.close()
        if bad:
            raise self._stopped(bad, alone=False)
        return self._close(state, rows, interrupt.number)

    def _close(self, state: TrainState, rows: list[Row], stopped_by: int | None) -> Trained:
        """Evaluates and reports the run; one that was stopped is only reported."""
        wall_s = self.earlier_s + time.perf_counter() - self.began
        plain = to_host(state)
        updates = updates_done(plain)
        ended = Trained(
            env=self.env,
            params=self.params,
            config=self.config,
            run_dir=self.run_dir,
            weights=plain.weights,
            rows=rows,
            updates=updates,
            new_updates=updates - self.done,
            wall_s=wall_s,
            compile_s=self.compile_s,
            train_s=self.train_s,
        )
        if is_first():
            try:
                played = write_results(ended, self.evaluation if stopped_by is None else None)
                ended = dataclasses.replace(ended, played=played)
            except KeyboardInterrupt as error:
                write_results(ended, None)
                raise _interrupted(signal_of(error), self._next_step(updates)) from None
        if stopped_by is not None:
            raise _interrupted(stopped_by, self._next_step(updates), alone=False)
        return ended

    def _next_step(self, updates: int) -> str:
        """Message that tells how to continue after so many updates: train, or else only evaluate."""
        path, algorithm = self.run_dir.path, self.config.algorithm
        what, again = f"after update {updates}, saved; go on with", f"{algorithm} --resume"
        if updates >= self.config.num_updates:
            what, again = "after the last update; evaluate with", "evaluate --run-dir"
        if self.run_dir.given:
            return f'{what}: train.api, with the same environment and "{path}"'
        return f"{what}: python -m train.{again} {path}"

    def _announce(self) -> None:
        if not is_first():
            return
        config, device = self.config, jax.devices()[0]
        seeds = f" x {config.num_seeds} seeds" if config.num_seeds > 1 else ""
        shared = f" in {jax.process_count()} processes" if jax.process_count() > 1 else ""
        # Settings of a run in another world keep its length of a rollout.
        episode = -(-episode_decisions(self.params) // config.decide_every)
        cut = config.choices_per_update % episode if episode else 0
        cuts = f" (an episode has {episode})" if cut else ""
        print(
            f"{'resuming' if self.resumed else 'training'} {config.scenario} in {self.run_dir.path}:"
            f" {config.num_updates} updates of {config.num_envs} x {config.choices_per_update} choices{cuts}{seeds},"
            f" {device.platform} {device.device_kind}{shared}, {self.takes}",
            flush=True,
        )

    def _compile(self) -> tuple[Any, Any]:
        """The two programs, compiled ahead of time and in parallel; `init` is None where it is not needed.

        The closing evaluation compiles after them in the background, while training begins.
        """
        start = time.perf_counter()
        waiting = None
        if self.saved is None:
            lowered = self.programs.init.lower(jax.random.key(self.config.seed), self.params)
            waiting = self.behind.submit(lowered.compile, compiler_options=ONCE)
        lowered = self.programs.run.lower(self.shapes, self.params, jnp.int32(1))
        if self.config.eval_episodes and is_first():
            self.evaluation = self.behind.submit(
                prepare_evaluation, self.env, self.params, self.config, self.shapes.weights
            )
        program = compiled(lowered)
        ready = waiting.result() if waiting is not None else None
        self.compile_s = time.perf_counter() - start
        return ready, program

    def _begin(self, init: Any) -> TrainState:
        if self.saved is None:
            return init(jax.random.key(self.config.seed), self.params)
        saved, self.saved = self.saved, None
        return to_devices(saved, self.shapes, self.programs.shardings)

    def _drive(
        self,
        run: Any,
        state: TrainState,
        log: MetricsLog | None,
        progress: Progress,
        interrupt: Interrupt,
    ) -> tuple[TrainState, str | None]:
        """Calls the program until all updates are done or a signal arrives, then saves the state.

        Returns the state, and what in it is not finite, if anything; such a state is not saved.
        """
        config, started = self.config, time.perf_counter()
        steps = config.steps_per_update * config.num_seeds
        done, per_update_s = self.done, SECONDS_PER_CALL
        while done < config.num_updates:
            said = agree(self._chunk(done, per_update_s), interrupt.number or 0)
            count, interrupt.number = int(said[0, 0]), int(said[:, 1].max()) or None
            if interrupt.number:
                break
            called = time.perf_counter()
            interrupt.busy_s = count * per_update_s if done > self.done else math.inf
            state, metrics = run(state, self.params, jnp.int32(count))
            metrics = jax.device_get(computed(metrics))
            per_update_s = (time.perf_counter() - called) / count
            healthy, bad = finite_updates(metrics.pop(BAD)[..., :count])
            before_s = self.earlier_s + called - self.began
            rows = [
                {
                    "update": done + number,
                    "env_steps": (done + number) * steps,
                    "wall_s": round(before_s + number * per_update_s, 3),
                    "env_steps_per_s": steps / per_update_s,
                    **row,
                }
                for number, row in enumerate(rows_from(metrics, count), 1)
            ]
            done += count
            if bad:
                rows = rows[: healthy + 1]
                bad = f"{bad} no longer finite in update {rows[-1]['update']}"
            if log:
                log.write(rows)
            progress.show(rows)
            self._tell(rows)
            if bad:
                return state, bad
            if config.checkpoint_interval and done % config.checkpoint_interval == 0:
                self._save(state)
        self._save(state)
        self.train_s = time.perf_counter() - started
        return state, None

    def _chunk(self, done: int, per_update_s: float) -> int:
        """Number of updates in the next call: about a second's worth, not past the end or the next checkpoint."""
        config = self.config
        most = min(config.updates_per_call, config.num_updates - done)
        if config.checkpoint_interval:
            most = min(most, config.checkpoint_interval - done % config.checkpoint_interval)
        return max(1, min(most, int(SECONDS_PER_CALL / per_update_s)))

    def _save(self, state: TrainState) -> None:
        plain = to_host(state)
        if is_first():
            if updates_done(plain) > self.done:  # else the results are still of these weights
                self.run_dir.remove_results()
            self.checkpoints.save(plain, self.config)

    def _newest(self) -> str:
        """Message that tells which checkpoint is the newest."""
        update = self.checkpoints.latest()
        return (
            "there is no checkpoint"
            if update is None
            else f"the newest checkpoint is of update {update}"
        )

    def _tell(self, rows: list[Row]) -> None:
        """Hands rows to the callback. An OSError that it raises must not pass for a failed write of the run."""
        if self.callback is None or not is_first():
            return
        for row in rows:
            try:
                self.callback(dict(row))
            except OSError as error:
                raise RuntimeError(f"the callback failed: {one_line(str(error))}") from error

    def _stopped(self, what: str, alone: bool = True) -> StoppedError:
        return StoppedError(1, f"{what}: stopped; {self._newest()}", alone)


def _interrupted(number: int, what: str, alone: bool = True) -> StoppedError:
    return StoppedError(128 + number, f"interrupted {what}", alone)
