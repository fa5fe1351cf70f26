"""`python -m benchmarks.training`: wall time of training, and its speed relative to the simulator alone.

The command starts `python -m train.ppo` in its own process, as a user would, one process at a time. The first start is
cold, with an empty persistent compilation cache; the second is warm, from the cache that the first one left. Then
`python -m benchmarks.throughput` runs with the same number of environments. `--repeats` repeats all three, each time
with a new cache; figures are medians, column by column.

Seconds of wall time:
- total: the whole process, with imports, compilation, training, evaluation and report.
- compile, training: as the run reports them (compile_s and train_s of summary.json). Compile covers the training
  programs only: the evaluation compiles beside the first updates, and any remainder counts as evaluation.
  Training includes writing the checkpoints.
- evaluation: the closing evaluation of the learned and the other policies, and the picture (evaluation_s).
- other: the rest: starting Python, imports, building the environment, exiting.

Decisions/s is the median over updates, since the first updates share the machine with the compilation of the closing
evaluation.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from benchmarks.command import ROOT, add_number, add_scenario, benchmark_parser, run_command, say
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import settings_from_text
from train.runs.logs import read_rows
from train.runs.run_directory import RunDir
from train.settings import TrainConfig, from_json

# Settings passed to the command; the other options are not training settings.
PASSED_ON = ("scenario", "num_envs", "total_timesteps", "seed")
HEADINGS = ("total", "compile", "training", "evaluation", "other")


class CommandError(RuntimeError):
    """A command failed; the message holds the last line of its output."""


# Of one start: total_s, compile_s, train_s, evaluation_s and other_s, explained above, and decisions_per_s.
Wall = dict[str, float]


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
    parts = {name: summary[name] for name in ("compile_s", "train_s", "evaluation_s")}
    other = {"other_s": total_s - sum(parts.values()), "decisions_per_s": statistics.median(paces)}
    return {"total_s": total_s, **parts, **other}


def median(walls: Sequence[Wall]) -> Wall:
    """Median of each figure on its own, so the parts need not add up to the total."""
    return {name: statistics.median(wall[name] for wall in walls) for name in walls[0]}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Runs everything and prints the table.

    Raises:
        InputError: a setting is out of range.
        CommandError: a run failed.
    """
    given = {name: getattr(options, name) for name in PASSED_ON}
    config, repeats = from_json(settings_from_text(PPOConfig, given), PPOConfig), options.repeats
    walls: dict[str, list[Wall]] = {"cold": [], "warm": []}
    speeds: list[float] = []
    # This process must not start JAX before the last run has ended: on a GPU it would take up their memory.
    with tempfile.TemporaryDirectory() as folder:
        for number in range(1, repeats + 1):
            place = Path(folder) / str(number)
            for name in walls:
                run_dir = RunDir(place / name)
                walls[name].append(start(config, run_dir, place / "cache"))
                say(f"repeat {number}/{repeats}: {name} {walls[name][-1]['total_s']:.1f} s")
            speeds.append(throughput(config, place / "throughput.json"))
        summary = json.loads(run_dir.summary.read_text(encoding="utf-8"))
    shares = (
        warm["decisions_per_s"] / alone for warm, alone in zip(walls["warm"], speeds, strict=True)
    )
    result = {
        "scenario": config.scenario,
        "num_envs": config.num_envs,
        "env_steps": summary["env_steps"],
        "seed": config.seed,
        "repeats": repeats,
        **{name: summary[name] for name in ("backend", "device")},
        "jax_version": jax.__version__,
        **{name: median(each) for name, each in walls.items()},
        "runs": walls,
        "throughput_per_s": statistics.median(speeds),
        "by_throughput": statistics.median(shares),
    }
    print(report(result))
    return result


def report(result: Mapping[str, Any]) -> str:
    """Formats the result of `measure`, and the speed of training beside the simulator alone."""
    headings = "".join(f"{heading:>12}" for heading in HEADINGS)
    lines = [
        f"{result['env_steps']:,} decisions of {result['scenario']}, {result['num_envs']} environments, "
        f"{result['backend']} ({result['device']}); seconds, medians of {result['repeats']}",
        "",
        f"{'':6}{headings}{'decisions/s':>14}",
    ]
    for name in ("cold", "warm"):
        *seconds, speed = result[name].values()
        lines.append(f"{name:6}" + "".join(f"{part:12.1f}" for part in seconds) + f"{speed:14,.0f}")
    alone = (
        f"without learning {result['throughput_per_s']:,.0f} decisions/s; "
        f"training has {result['by_throughput']:.2f} of them"
    )
    return "\n".join([*lines, "", alone])


def main(arguments: list[str] | None = None) -> int:
    """The command.

    Returns:
        The exit code: 0 done, 1 the training command failed.
    """
    # Training settings stay text, so that `measure` reports errors in the words of train.ppo.
    parser = benchmark_parser("training", __doc__)
    parser.add_argument(
        "--num-envs", default="256", help="environments side by side (default: 256)"
    )
    rounded = "decisions, rounded up to whole updates (default: 400000)"
    parser.add_argument("--total-timesteps", default="400000", help=rounded)
    add_scenario(parser)
    parser.add_argument("--seed", default="0", help="seed of the training (default: 0)")
    add_number(parser, "--repeats", 1, "number of cold and of warm starts")
    try:
        run_command(parser, measure, arguments)
    except CommandError as error:
        say(f"python -m benchmarks.training: {error}")
        return 1
    return 0
