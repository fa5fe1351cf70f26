"""What training reports while it runs: metrics.jsonl, TensorBoard and the progress bar."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from train.config import TrainConfig
from train.rundir import RunDir

Row = dict[str, Any]
MAIN = "episode_return"


def plain(value: float) -> float | None:
    """A number for JSON, which has no NaN: None stands for "there was none"."""
    return float(value) if math.isfinite(value) else None


def rows_from(metrics: dict[str, Any], count: int) -> list[Row]:
    """Metrics of `Learner.run` as one dict an update.

    With several seeds each value is the mean over those that have one, and `per_seed` lists them.

    Args:
        metrics: arrays `(places,)` or `(num_seeds, places)`.
        count: leading places that are filled.
    """
    columns = {
        name: np.asarray(values, np.float64)[..., :count] for name, values in metrics.items()
    }
    rows = []
    for index in range(count):
        cells = {name: column[..., index] for name, column in columns.items()}
        row: Row = {name: plain(_mean(cell)) for name, cell in cells.items()}
        if next(iter(cells.values())).ndim:
            row["per_seed"] = {
                name: [plain(value) for value in cell] for name, cell in cells.items()
            }
        rows.append(row)
    return rows


def _mean(values: np.ndarray) -> float:
    there = np.atleast_1d(values)
    there = there[np.isfinite(there)]
    return float(there.mean()) if there.size else math.nan


def read_rows(path: Path) -> list[Row]:
    """Lines of metrics.jsonl; a last line cut off in the writing is left out."""
    rows = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                rows.append(json.loads(line))
            except ValueError:
                break
    return rows


class MetricsLog:
    """metrics.jsonl and TensorBoard.

    Args:
        run_dir: directory of the run.
        done: updates that training goes on from. Lines of later ones, written after the checkpoint by a run that was
            killed, are dropped because they will be computed again.
    """

    def __init__(self, run_dir: RunDir, done: int) -> None:
        self.rows = [row for row in read_rows(run_dir.metrics) if row["update"] <= done]
        text = "".join(json.dumps(row) + "\n" for row in self.rows)
        if run_dir.metrics.exists():
            partial = run_dir.metrics.with_suffix(".partial")
            partial.write_text(text, encoding="utf-8")
            partial.replace(run_dir.metrics)
        self._file = run_dir.metrics.open("a", encoding="utf-8")
        self._board = _tensorboard(run_dir.tensorboard, self.rows)

    def write(self, rows: list[Row]) -> None:
        """Appends rows; they are on disk when this returns."""
        self.rows += rows
        for row in rows:
            self._file.write(json.dumps(row, allow_nan=False) + "\n")
            self._write_board(row)
        self._file.flush()

    def _write_board(self, row: Row) -> None:
        if self._board is None:
            return
        for name, value in row.items():
            if isinstance(value, float):
                group = "episode" if name.startswith("episode") else "train"
                self._board.add_scalar(f"{group}/{name}", value, row["env_steps"])

    def close(self) -> None:
        """Closes the files."""
        self._file.close()
        if self._board is not None:
            self._board.close()


def _tensorboard(path: Path, rows: list[Row]) -> Any:
    """A writer of event files; None without tensorboardX."""
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        return None
    # Steps from here on hide those of a killed run.
    return SummaryWriter(str(path), purge_step=rows[-1]["env_steps"] + 1 if rows else None)


class Progress:
    """A progress bar on stderr, silent where that is no terminal."""

    def __init__(self, config: TrainConfig, done: int, what: str) -> None:
        self._steps = config.steps_per_update * config.num_seeds
        self._bar = tqdm(
            total=config.num_updates * self._steps,
            initial=done * self._steps,
            unit="step",
            unit_scale=True,
            dynamic_ncols=True,
            disable=not sys.stderr.isatty(),
            desc=what,
            leave=what != "compiling",
        )
        self._done = done
        self._returned = False

    def show(self, rows: list[Row]) -> None:
        """Moves on by the updates in `rows`, and shows the newest return there is."""
        returns = [row[MAIN] for row in rows if row.get(MAIN) is not None]
        if returns:
            self._bar.set_postfix_str(f"return {returns[-1]:.4g}", refresh=False)
        elif not self._returned:  # the first whole episodes end late
            self._bar.set_postfix_str(f"reward {rows[-1]['reward_mean'] or 0.0:.3g}", refresh=False)
        self._returned |= bool(returns)
        self._bar.update((rows[-1]["update"] - self._done) * self._steps)
        self._done = rows[-1]["update"]

    def close(self) -> None:
        """Leaves the bar as it is."""
        self._bar.close()
