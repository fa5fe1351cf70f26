"""Runs `python -m train.ppo`, or the simulator alone, in its own process and takes the wall time."""

import dataclasses
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from train.runs.logs import read_rows
from train.runs.run_directory import RunDir
from train.settings import TrainConfig

# Settings passed to the command.
PASSED_ON = ("scenario", "num_envs", "total_timesteps", "seed")
ROOT = Path(__file__).resolve().parents[2]  # where `-m train.ppo` is found, wherever this is called


class CommandError(RuntimeError):
    """A command failed; the message holds the last line of its output."""


@dataclasses.dataclass(frozen=True)
class Wall:
    """Wall times of one start, explained in `benchmarks.speed.training`."""

    total_s: float
    compile_s: float
    train_s: float
    evaluation_s: float
    other_s: float
    decisions_per_s: float  # median over updates


def start(config: TrainConfig, run_dir: RunDir, cache: Path) -> Wall:
    """Runs the training command to its end; results go to `run_dir`, compiled programs to `cache`.

    Raises:
        CommandError: the command failed.
    """
    given = [f"--{name.replace('_', '-')}={getattr(config, name)}" for name in PASSED_ON]
    began = time.perf_counter()
    _run(["train.ppo", f"--run-dir={run_dir.path}", *given], JAX_COMPILATION_CACHE_DIR=str(cache))
    total_s = time.perf_counter() - began
    paces = [row["env_steps_per_s"] for row in read_rows(run_dir.metrics)]
    return split(json.loads(run_dir.summary.read_text(encoding="utf-8")), paces, total_s)


def throughput(config: TrainConfig, file: Path) -> float:
    """Decisions/s of `python -m benchmarks.throughput` with as many environments; its JSON goes to `file`.

    Raises:
        CommandError: the command failed.
    """
    given = [f"--num-envs={config.num_envs}", f"--scenario={config.scenario}", f"--json={file}"]
    _run(["benchmarks.throughput", *given])
    return float(json.loads(file.read_text(encoding="utf-8"))["env_steps_per_s"])


def _run(command: Sequence[str], **environment: str) -> None:
    """Runs `python -m` with a command to its end.

    Raises:
        CommandError: the command failed.
    """
    ended = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=ROOT,
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    if ended.returncode:
        lines = (ended.stdout + "\n" + ended.stderr).split("\n")
        said = [line for line in lines if line.strip()] or ["it said nothing"]
        raise CommandError(f"{command[0]} ended with code {ended.returncode}: {said[-1]}")


def split(summary: Mapping[str, Any], paces: Sequence[float], total_s: float) -> Wall:
    """Splits the wall time of one process.

    Args:
        summary: its summary.json.
        paces: decisions/s of each update.
        total_s: seconds from its start to its end.
    """
    names = "compile_s", "train_s", "evaluation_s"
    compile_s, train_s, evaluation_s = (summary[name] for name in names)
    other_s = total_s - (compile_s + train_s + evaluation_s)
    speed = statistics.median(paces)
    return Wall(total_s, compile_s, train_s, evaluation_s, other_s, speed)


def median(walls: Sequence[Wall]) -> Wall:
    """Median of each figure on its own, so the parts need not add up to the total."""
    columns = zip(*map(dataclasses.astuple, walls), strict=True)
    return Wall(*map(statistics.median, columns))
