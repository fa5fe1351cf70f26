"""Logs of a run in progress: metrics.jsonl, TensorBoard and the progress bar."""

import contextlib
import json
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from medjax.commandline import SECONDS_PER_LINE, time_left
from medjax.errors import InputError, shown
from medjax.files import write_text
from medjax.streams import shows_bars
from train.evaluation.statistics import plain
from train.runs.run_directory import RunDir
from train.settings import TrainConfig

Row = dict[str, Any]
MAIN = "episode_return"


def rows_from(metrics: dict[str, Any], count: int) -> list[Row]:
    """The metrics of `train.algorithms.programs.run_updates` as one dict per update.

    With several seeds a value is the mean over the seeds that have a finite one, and `per_seed` lists all of them.

    Args:
        metrics: arrays `(places,)` or `(num_seeds, places)`.
        count: number of leading places that are filled.
    """
    columns = {name: np.asarray(values, np.float64) for name, values in metrics.items()}
    rows = []
    for index in range(count):
        cells = {name: column[..., index] for name, column in columns.items()}
        row: Row = {name: plain(_mean(cell)) for name, cell in cells.items()}
        if next(iter(cells.values())).ndim:
            row["per_seed"] = {name: [*map(plain, cell)] for name, cell in cells.items()}
        rows.append(row)
    return rows


def _mean(values: np.ndarray) -> float:
    there = np.atleast_1d(values)
    there = there[np.isfinite(there)]
    return float(there.mean()) if there.size else math.nan


def read_rows(path: Path) -> list[Row]:
    """The rows of metrics.jsonl, without a last line that was cut off while it was written.

    Raises:
        InputError: any other line is damaged, or the file is no text.
    """
    rows: list[Row] = []
    allowed = "allowed JSON, as train.ppo wrote it"
    try:
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file: {allowed}") from None
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            if number == len(lines):
                break
            row = None
        if not isinstance(row, dict) or type(row.get("update")) is not int:
            raise InputError(f"{path}, line {number} = {shown(line)}: {allowed}")
        rows.append(row)
    return rows


def final_return(rows: Sequence[Row]) -> float | None:
    """Mean return of the whole episodes that ended in the last tenth of the updates; None if none did."""
    last = rows[-max(1, len(rows) // 10) :]
    pairs = [(row[MAIN], row["episodes"]) for row in last if row.get(MAIN) is not None]
    episodes = sum(count for _, count in pairs)
    return sum(value * count for value, count in pairs) / episodes if episodes else None


class MetricsLog:
    """metrics.jsonl and TensorBoard.

    Args:
        run_dir: directory of the run.
        done: number of updates that training continues from. Rows of later updates, which a killed run wrote after its
            last checkpoint, are dropped because they will be computed again; so is a line that was cut off.

    Raises:
        OSError: the files cannot be written.
    """

    def __init__(self, run_dir: RunDir, done: int) -> None:
        self.rows = [row for row in read_rows(run_dir.metrics) if row["update"] <= done]
        self._path = run_dir.metrics
        write_text(self._path, "".join(map(_line, self.rows)))
        self._board: _Board | None = None
        with contextlib.suppress(ImportError):  # TensorBoard is optional
            self._board = _Board(run_dir.tensorboard, self.rows)

    def write(self, rows: list[Row]) -> None:
        """Appends rows, all of them or none; they are in the file when this returns.

        Raises:
            OSError: the disk is full, or the file is gone.
        """
        self.rows += rows
        text = "".join(map(_line, rows)).encode()
        # Opening the file for each write reveals a directory that was removed.
        with self._path.open("r+b", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            try:
                while text:
                    text = text[file.write(text) :]
            except BaseException:
                file.truncate(end)
                raise
        if self._board is not None:
            self._board.write(rows)

    def close(self) -> None:
        """Closes the files."""
        if self._board is not None:
            self._board.close()


def _line(row: Row) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


class _Board:
    """TensorBoard's event files, written in this thread so that a failure is noticed.

    tensorboardX's SummaryWriter writes in a thread of its own. When a full disk kills that, its queue fills up and
    training hangs.
    """

    def __init__(self, path: Path, rows: list[Row]) -> None:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event, SessionLog
        from tensorboardX.summary import scalar

        self._event, self._scalar = Event, scalar
        path.mkdir(parents=True, exist_ok=True)
        earlier = any(path.iterdir())
        self._file = EventsWriter(str(path / "events"), f".{os.getpid()}")
        if earlier:  # TensorBoard then hides later steps of a killed run
            start = SessionLog(status=SessionLog.START)
            self._add(rows[-1]["env_steps"] + 1 if rows else 0, session_log=start)

    def write(self, rows: list[Row]) -> None:
        """Adds every number of the rows."""
        for row in rows:
            for name, value in row.items():
                if isinstance(value, float):
                    _, of_episode, figure = name.partition("episode_")
                    tag = f"episode/{figure}" if of_episode else f"train/{name}"
                    self._add(row["env_steps"], summary=self._scalar(tag, value))
        self._file.flush()

    def _add(self, step: int, **what: Any) -> None:
        self._file.write_event(self._event(wall_time=time.time(), step=step, **what))

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class Progress:
    """Progress of training: a bar on stderr or, if that is not a terminal, a line on stdout about every ten seconds.

    The first line comes with the first update. `quiet` shows nothing.
    """

    def __init__(self, config: TrainConfig, done: int, what: str, quiet: bool = False) -> None:
        self._updates, self._steps = config.num_updates, config.steps_per_update * config.num_seeds
        self._bar = tqdm(
            total=self._updates * self._steps,
            initial=done * self._steps,
            unit="step",
            unit_scale=True,
            dynamic_ncols=True,
            disable=quiet or not shows_bars(),
            desc=what,
            leave=what != "compiling",
        )
        self._lines = not quiet and not shows_bars()
        self._next_line = 0.0
        self._done = done
        self._score = ""
        if self._lines and what == "compiling":
            print("compiling, a minute or two where it was not before", flush=True)

    def show(self, rows: list[Row]) -> None:
        """Advances by the updates in `rows`, and shows the newest return."""
        returns = [row[MAIN] for row in rows if row.get(MAIN) is not None]
        if returns:
            self._score = f"return {returns[-1]:.4g}"
        elif not self._score.startswith("return"):  # no whole episode has ended yet
            self._score = f"reward {rows[-1]['reward_mean'] or 0.0:.3g}"
        self._bar.set_postfix_str(self._score, refresh=False)
        self._bar.update((rows[-1]["update"] - self._done) * self._steps)
        self._done = rows[-1]["update"]
        now = time.perf_counter()
        if self._lines and now >= self._next_line:
            self._next_line = now + SECONDS_PER_LINE
            row = rows[-1]
            rate = row["env_steps_per_s"]
            left_s = (self._updates - row["update"]) * row["env_steps"] / row["update"] / rate
            decisions = f"{row['env_steps']:,} decisions, {rate:,.0f} a second"
            done = f"update {row['update']} of {self._updates}: {decisions}"
            print(f"{done}, {self._score}, {time_left(left_s)}", flush=True)

    def close(self) -> None:
        """Leaves the bar as it is."""
        self._bar.close()
