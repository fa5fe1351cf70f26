"""`python -m benchmarks.training`: how long the training command takes, and when it beats the greedy dispatcher.

The real command, `python -m train.ppo`, runs in a process of its own as a user would start it, one process at a
time: first cold, with an empty persistent cache of compiled programs, then warm, from the cache that the cold start
left. `--repeats` does both again, each time with a new cache; figures are medians, column by column.

Seconds of wall time:
- total: from starting the process to its end, so imports, compilation, training, evaluation and report.
- compile, training: what the run itself says (compile_s and train_s of summary.json). Compile is of the training
  programs; the evaluation's is a part of evaluation. Training includes writing the checkpoints.
- evaluation: the closing evaluation of the learned and the other policies, and the picture (evaluation_s).
- other: the rest: starting Python, imports, building the environment, ending.

Greedy is beaten at the first checkpoint whose weights (most probable actions) return more than greedy on the episodes
of the closing evaluation: the lower end of the 95 % bootstrap interval of the mean paired difference is above 0.
Checkpoints are played after all runs, outside of what is timed. They are what is compared because the learning curve
in metrics.jsonl is that of a policy that still tries things, over whole episodes, which begin after 600 decisions a
road. The command is therefore told to keep about 8 checkpoints spread evenly; the time is known to that distance. It
is the wall_s of that update in metrics.jsonl: seconds on the clock of the run, compilation included, which starts
after the imports (they are in "other"). Runs of one seed learn the same, so the checkpoints of the first are played
and every run gives its own time.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import medjax
from benchmarks.command import benchmark_parser, positive
from medjax.commandline import OneLineParser
from medjax.errors import InputError
from medjax.wrappers import prepare_cpu
from train.algorithms.environments import make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.evaluation.statistics import bootstrap_ci95
from train.runs.arguments import settings_from_text
from train.runs.logs import read_rows
from train.runs.run_directory import RunDir
from train.settings import TrainConfig, from_json

CHECKPOINTS = (
    8  # about so many in a run: a finer curve costs training time, each takes tenths of a second
)
PASSED_ON = (  # settings that the command is given
    "scenario",
    "num_envs",
    "total_timesteps",
    "seed",
    "checkpoint_interval",
    "keep_checkpoints",
)
ROOT = Path(__file__).resolve().parents[2]  # where `-m train.ppo` is found, wherever this is called
HEADINGS = ("total", "compile", "training", "evaluation", "other")


class CommandError(RuntimeError):
    """The training command failed; the message is its last line."""


@dataclasses.dataclass(frozen=True)
class Wall:
    """What one start took, in seconds; see the module's docstring."""

    total_s: float
    compile_s: float
    train_s: float
    evaluation_s: float
    other_s: float
    decisions_per_s: float  # while training


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """How the weights of one checkpoint play."""

    update: int
    return_mean: float
    gain_ci95: tuple[float, float]  # of the mean paired difference to greedy, of returns


@dataclasses.dataclass(frozen=True)
class Beaten:
    """When greedy was beaten."""

    cold_s: float  # median over repeats
    warm_s: float
    update: int
    return_mean: float


def settings(given: Mapping[str, str]) -> TrainConfig:
    """Settings of the command from the text of the options.

    Raises:
        InputError: a value out of its range.
    """
    config = from_json(settings_from_text(PPOConfig, dict(given)), PPOConfig)
    return dataclasses.replace(
        config,
        checkpoint_interval=-(-config.num_updates // CHECKPOINTS),
        keep_checkpoints=config.num_updates,
    )


def start(config: TrainConfig, run_dir: RunDir, cache: Path) -> Wall:
    """Runs the training command to its end.

    Args:
        config: settings; those of `PASSED_ON` count.
        run_dir: where its results go, not there yet.
        cache: directory of its compiled programs.

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
    """Parts of the wall time of one process.

    Args:
        summary: of summary.json.
        total_s: seconds from starting the process to its end.
    """
    parts = {name: summary[name] for name in ("compile_s", "train_s", "evaluation_s")}
    return Wall(
        total_s=total_s,
        other_s=total_s - sum(parts.values()),
        decisions_per_s=summary["env_steps_per_s"],
        **parts,
    )


def median(walls: Sequence[Wall]) -> Wall:
    """Median of each figure by itself; so the parts need not add up to the total."""
    columns = zip(*map(dataclasses.astuple, walls), strict=True)
    return Wall(*map(statistics.median, columns))


def reached_s(run_dir: RunDir, update: int) -> float:
    """Seconds on the run's clock until `update` was done."""
    rows = read_rows(run_dir.metrics)
    return next(float(row["wall_s"]) for row in rows if row["update"] == update)


def compare(update: int, ours: np.ndarray, greedy: np.ndarray, seed: int) -> Checkpoint:
    """A checkpoint against greedy.

    Args:
        update: of the checkpoint.
        ours: its returns, `(episodes,)`.
        greedy: those of greedy on the same episodes.
        seed: of the bootstrap.
    """
    return Checkpoint(update, float(ours.mean()), bootstrap_ci95(ours - greedy, seed))


def first_beaten(curve: Sequence[Checkpoint]) -> Checkpoint | None:
    """The earliest checkpoint that is surely above greedy; None if none is."""
    return next((point for point in curve if point.gain_ci95[0] > 0), None)


def play_checkpoints(run_dir: RunDir) -> tuple[float, list[Checkpoint]]:
    """Plays every checkpoint of a run and greedy on the episodes of the closing evaluation.

    Returns:
        The mean return of greedy, and the checkpoints from the first to the last.
    """
    # Flax and the learner take seconds to import; bad options need not wait for them.
    from medjax.episodes.scores import evaluate_policies
    from train.algorithms.registry import algorithm_of
    from train.runs.checkpoint import Checkpoints
    from train.runs.policies import weight_shapes

    config = run_dir.load_config()
    env, params = make_environment(config)
    learn = algorithm_of(config)
    shapes = weight_shapes(env, params, config)
    policies = {"greedy": medjax.BASELINES["greedy"](env)}
    reader = Checkpoints(run_dir.path)
    updates = reader.all()
    for update in updates:
        policies[str(update)] = learn.policy(env, config, reader.restore_weights(shapes, update))
    scores = evaluate_policies(env, params, policies, config.eval_episodes, config.seed)
    greedy = scores["greedy"]["return"]
    curve = [compare(each, scores[str(each)]["return"], greedy, config.seed) for each in updates]
    return float(greedy.mean()), curve


def say(line: str) -> None:
    """Progress, on stderr."""
    print(line, file=sys.stderr, flush=True)


def measure(config: TrainConfig, repeats: int) -> dict[str, Any]:
    """All runs; what `--json` writes.

    Raises:
        CommandError: a run failed.
    """
    walls: dict[str, list[Wall]] = {"cold": [], "warm": []}
    runs: dict[str, list[RunDir]] = {"cold": [], "warm": []}
    # Nothing here may start JAX before the last run has ended: on a GPU it would take the memory from them.
    with tempfile.TemporaryDirectory() as folder:
        for number in range(1, repeats + 1):
            place = Path(folder) / str(number)
            for name in walls:
                run_dir = RunDir(place / name)
                wall = start(config, run_dir, place / "cache")
                walls[name].append(wall)
                runs[name].append(run_dir)
                say(f"repeat {number}/{repeats}: {name} {wall.total_s:.1f} s")
        first = runs["cold"][0]
        summary = json.loads(first.summary.read_text(encoding="utf-8"))
        say("playing the checkpoints")
        greedy, curve = play_checkpoints(first)
        point = first_beaten(curve)
        beaten = None
        if point is not None:
            times = {
                f"{name}_s": statistics.median(reached_s(run_dir, point.update) for run_dir in dirs)
                for name, dirs in runs.items()
            }
            beaten = Beaten(update=point.update, return_mean=point.return_mean, **times)
    return {
        "scenario": config.scenario,
        "num_envs": config.num_envs,
        "env_steps": summary["env_steps"],
        "seed": config.seed,
        "repeats": repeats,
        "backend": summary["backend"],
        "device": summary["device"],
        "jax_version": jax.__version__,
        **{name: dataclasses.asdict(median(each)) for name, each in walls.items()},
        "runs": {name: [dataclasses.asdict(wall) for wall in each] for name, each in walls.items()},
        "greedy_return_mean": greedy,
        "greedy_beaten": dataclasses.asdict(beaten) if beaten is not None else None,
        "checkpoints": [dataclasses.asdict(each) for each in curve],
    }


def report(result: Mapping[str, Any]) -> str:
    """The table, and when greedy was beaten.

    Args:
        result: of `measure`.
    """
    lines = [
        f"{result['env_steps']:,} decisions of {result['scenario']}, {result['num_envs']} environments, "
        f"{result['backend']} ({result['device']}); seconds, medians of {result['repeats']}",
        "",
        f"{'':6}" + "".join(f"{heading:>12}" for heading in HEADINGS) + f"{'decisions/s':>14}",
    ]
    for name in ("cold", "warm"):
        wall = Wall(**result[name])
        *seconds, speed = dataclasses.astuple(wall)
        lines.append(f"{name:6}" + "".join(f"{part:12.1f}" for part in seconds) + f"{speed:14,.0f}")
    greedy = result["greedy_return_mean"]
    if result["greedy_beaten"] is not None:
        beaten = Beaten(**result["greedy_beaten"])
        verdict = (
            f"greedy beaten after {beaten.cold_s:.1f} s, warm {beaten.warm_s:.1f} s "
            f"(update {beaten.update}, return {beaten.return_mean:.1f} against {greedy:.1f})"
        )
    else:
        last = result["checkpoints"][-1]
        verdict = (
            f"greedy not beaten (last update {last['update']}, "
            f"return {last['return_mean']:.1f} against {greedy:.1f})"
        )
    return "\n".join([*lines, "", verdict])


def build_parser() -> OneLineParser:
    """The options; those of the settings stay text, which `settings` checks in the words of train.ppo."""
    parser = benchmark_parser("training", __doc__)
    parser.add_argument("--num-envs", default="256", metavar="N", help="default: 256")
    parser.add_argument(
        "--total-timesteps",
        default="400000",
        metavar="N",
        help="decisions, rounded up to updates; default: 400000",
    )
    parser.add_argument(
        "--scenario", default="paper", choices=list(medjax.SCENARIOS), help="default: paper"
    )
    parser.add_argument("--seed", default="0", metavar="N", help="default: 0")
    parser.add_argument(
        "--repeats",
        type=positive,
        default=1,
        metavar="N",
        help="cold and warm starts each; default: 1",
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Prints the table and writes the same as JSON.

    Returns:
        The exit code: 0 done, 1 the training command failed, 130 interrupted.
    """
    parser = build_parser()
    given = vars(parser.parse_args(arguments))
    prepare_cpu()
    repeats, target = given.pop("repeats"), given.pop("json")
    try:
        config = settings(given)
    except InputError as error:
        parser.error(str(error))
    try:
        result = measure(config, repeats)
    except CommandError as error:
        say(f"python -m benchmarks.training: {error}")
        return 1
    except KeyboardInterrupt:
        say("interrupted")
        return 130
    if target is not None:
        target.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(report(result))
    return 0


def run() -> int:
    """`main` as a process of its own."""
    # As Ctrl-C: subprocess.run ends the process that it waits for when an exception passes through it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    return main()
