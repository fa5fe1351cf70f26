"""One start of `python -m train.ppo` in a process of its own, and the parts of its wall time."""

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

from train.runs.run_directory import RunDir
from train.settings import TrainConfig

PASSED_ON = (  # settings that the command is given
    "scenario",
    "num_envs",
    "total_timesteps",
    "seed",
    "checkpoint_interval",
    "keep_checkpoints",
)
ROOT = Path(__file__).resolve().parents[2]  # where `-m train.ppo` is found, wherever this is called


class CommandError(RuntimeError):
    """The training command failed; the message is its last line."""


@dataclasses.dataclass(frozen=True)
class Wall:
    """What one start took, in seconds; `benchmarks.speed.training` says what is in each."""

    total_s: float
    compile_s: float
    train_s: float
    evaluation_s: float
    other_s: float
    decisions_per_s: float  # while training


def start(config: TrainConfig, run_dir: RunDir, cache: Path) -> Wall:
    """Runs the training command to its end; its results go to `run_dir`, its compiled programs to `cache`.

    Raises:
        CommandError: it failed.
    """
    command = [sys.executable, "-m", "train.ppo", f"--run-dir={run_dir.path}"]
    command += [f"--{name.replace('_', '-')}={getattr(config, name)}" for name in PASSED_ON]
    began = time.perf_counter()
    ended = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    total_s = time.perf_counter() - began
    if ended.returncode:
        lines = (ended.stdout + "\n" + ended.stderr).split("\n")
        said = [line for line in lines if line.strip()] or ["it said nothing"]
        raise CommandError(f"train.ppo ended with code {ended.returncode}: {said[-1]}")
    return split(json.loads(run_dir.summary.read_text(encoding="utf-8")), total_s)


def split(summary: Mapping[str, Any], total_s: float) -> Wall:
    """Parts of the wall time of one process, from its summary.json and the seconds from its start to its end."""
    names = "compile_s", "train_s", "evaluation_s", "env_steps_per_s"
    compile_s, train_s, evaluation_s, speed = (summary[name] for name in names)
    other_s = total_s - (compile_s + train_s + evaluation_s)
    return Wall(total_s, compile_s, train_s, evaluation_s, other_s, speed)


def median(walls: Sequence[Wall]) -> Wall:
    """Median of each figure by itself; so the parts need not add up to the total."""
    columns = zip(*map(dataclasses.astuple, walls), strict=True)
    return Wall(*map(statistics.median, columns))
