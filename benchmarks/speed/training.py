"""`python -m benchmarks.training`: how long the training command takes, and what it keeps of the simulator's speed.

The real command, `python -m train.ppo`, runs in a process of its own as a user would start it, one process at a
time: first cold, with an empty persistent cache of compiled programs, then warm, from the cache that the cold start
left. Then `python -m benchmarks.throughput` with as many environments. `--repeats` does all three again, each time with
a new cache; figures are medians, column by column.

Seconds of wall time:
- total: from starting the process to its end, so imports, compilation, training, evaluation and report.
- compile, training: what the run itself says (compile_s and train_s of summary.json). Compile is of the training
  programs; the evaluation's goes on beside the first updates, and what is left of it then is a part of evaluation.
  Training includes writing the checkpoints.
- evaluation: the closing evaluation of the learned and the other policies, and the picture (evaluation_s).
- other: the rest: starting Python, imports, building the environment, ending.

Decisions/s are those of the middle one of the updates: while the first run, the closing evaluation is still being
compiled beside them.
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

OWN = ("repeats", "json")  # options that are no settings
HEADINGS = ("total", "compile", "training", "evaluation", "other")


def settings(given: Mapping[str, str]) -> TrainConfig:
    """Settings of the command from the text of the options.

    Raises:
        InputError: a value out of its range.
    """
    return from_json(settings_from_text(PPOConfig, dict(given)), PPOConfig)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All runs; prints the table.

    Raises:
        InputError: of `settings`.
        CommandError: a run failed.
    """
    given = {name: value for name, value in vars(options).items() if name not in OWN}
    config, repeats = settings(given), options.repeats
    walls: dict[str, list[Wall]] = {"cold": [], "warm": []}
    speeds: list[float] = []
    # Nothing here may start JAX before the last run has ended: on a GPU it would take the memory from them.
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
    """The table of what `measure` returned, and training beside the simulator alone."""
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
    # The options; those of the settings stay text, which `settings` checks in the words of train.ppo.
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
