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
import dataclasses
import json
import statistics
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax

import medjax
from benchmarks.command import benchmark_parser, positive, run_command, say
from benchmarks.speed.training_process import CommandError, Wall, median, start, throughput
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import settings_from_text
from train.runs.run_directory import RunDir
from train.settings import TrainConfig, from_json

OWN = ("repeats", "json")  # options that are not training settings
HEADINGS = ("total", "compile", "training", "evaluation", "other")


def settings(given: Mapping[str, str]) -> TrainConfig:
    """Training settings from the text of the options.

    Raises:
        InputError: a value is out of range.
    """
    return from_json(settings_from_text(PPOConfig, dict(given)), PPOConfig)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Runs everything and prints the table.

    Raises:
        InputError: as in `settings`.
        CommandError: a run failed.
    """
    given = {name: value for name, value in vars(options).items() if name not in OWN}
    config, repeats = settings(given), options.repeats
    walls: dict[str, list[Wall]] = {"cold": [], "warm": []}
    speeds: list[float] = []
    # This process must not start JAX before the last run has ended: on a GPU it would take up their memory.
    with tempfile.TemporaryDirectory() as folder:
        for number in range(1, repeats + 1):
            place = Path(folder) / str(number)
            for name in walls:
                run_dir = RunDir(place / name)
                walls[name].append(start(config, run_dir, place / "cache"))
                say(f"repeat {number}/{repeats}: {name} {walls[name][-1].total_s:.1f} s")
            speeds.append(throughput(config, place / "throughput.json"))
        summary = json.loads(run_dir.summary.read_text(encoding="utf-8"))
    warm, alone = [wall.decisions_per_s for wall in walls["warm"]], statistics.median(speeds)
    result = {
        "scenario": config.scenario,
        "num_envs": config.num_envs,
        "env_steps": summary["env_steps"],
        "seed": config.seed,
        "repeats": repeats,
        **{name: summary[name] for name in ("backend", "device")},
        "jax_version": jax.__version__,
        **{name: dataclasses.asdict(median(each)) for name, each in walls.items()},
        "runs": {name: list(map(dataclasses.asdict, each)) for name, each in walls.items()},
        "throughput_per_s": alone,
        "by_throughput": statistics.median(w / s for w, s in zip(warm, speeds, strict=True)),
    }
    print(report(result))
    return result


def report(result: Mapping[str, Any]) -> str:
    """Formats the result of `measure`, and the speed of training beside the simulator alone."""
    lines = [
        f"{result['env_steps']:,} decisions of {result['scenario']}, {result['num_envs']} environments, "
        f"{result['backend']} ({result['device']}); seconds, medians of {result['repeats']}",
        "",
        f"{'':6}" + "".join(f"{heading:>12}" for heading in HEADINGS) + f"{'decisions/s':>14}",
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
    # Training settings stay text, so that `settings` reports errors in the words of train.ppo.
    parser = benchmark_parser("training", __doc__)
    add = partial(parser.add_argument, metavar="N")
    add("--num-envs", default="256", help="environments side by side (default: 256)")
    rounded = "decisions, rounded up to whole updates (default: 400000)"
    add("--total-timesteps", default="400000", help=rounded)
    parser.add_argument(
        "--scenario",
        default="paper",
        choices=list(medjax.SCENARIOS),
        help="preset (default: paper)",
    )
    add("--seed", default="0", help="seed of the training (default: 0)")
    add(
        "--repeats", type=positive, default=1, help="number of cold and of warm starts (default: 1)"
    )
    try:
        run_command(parser, measure, arguments)
    except CommandError as error:
        say(f"python -m benchmarks.training: {error}")
        return 1
    return 0
