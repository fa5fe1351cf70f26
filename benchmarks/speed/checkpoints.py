"""When a training run beat greedy: its checkpoints, played on the episodes of its closing evaluation."""

import dataclasses
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import medjax
from medjax.episodes.scores import evaluate_policies
from train.algorithms.environments import make_environment
from train.algorithms.registry import algorithm_of
from train.evaluation.statistics import bootstrap_ci95
from train.runs.checkpoint import Checkpoints
from train.runs.logs import read_rows
from train.runs.policies import weight_shapes
from train.runs.run_directory import RunDir


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """How the weights of one checkpoint play."""

    update: int
    return_mean: float
    gain_ci95: tuple[float, float]  # of the mean paired difference to greedy, of returns


def reached_s(run_dir: RunDir, update: int) -> float:
    """Seconds on the run's clock until `update` was done."""
    rows = read_rows(run_dir.metrics)
    return next(float(row["wall_s"]) for row in rows if row["update"] == update)


def compare(update: int, ours: np.ndarray, greedy: np.ndarray, seed: int) -> Checkpoint:
    """A checkpoint by its returns and those of greedy on the same episodes, `(episodes,)` each."""
    return Checkpoint(update, float(ours.mean()), bootstrap_ci95(ours - greedy, seed))


def first_beaten(curve: Sequence[Checkpoint]) -> Checkpoint | None:
    """The earliest checkpoint that is surely above greedy; None if none is."""
    return next((point for point in curve if point.gain_ci95[0] > 0), None)


def when_beaten(
    curve: Sequence[Checkpoint], runs: Mapping[str, Sequence[RunDir]]
) -> dict[str, Any] | None:
    """Update and return of the first checkpoint of a curve that beats greedy, None if none does, and `KIND_s`.

    That is how long each kind of start, which all learned the same, took until then: the median over its runs.
    """
    point = first_beaten(curve)
    if point is None:
        return None
    times = {
        f"{name}_s": statistics.median(reached_s(run_dir, point.update) for run_dir in dirs)
        for name, dirs in runs.items()
    }
    return {**times, "update": point.update, "return_mean": point.return_mean}


def play_checkpoints(run_dir: RunDir) -> tuple[float, list[Checkpoint]]:
    """The mean return of greedy on the episodes of a run's closing evaluation, and its checkpoints on the same."""
    config = run_dir.load_config()
    env, params = make_environment(config)
    learn, shapes = algorithm_of(config), weight_shapes(env, params, config)
    policies = {"greedy": medjax.BASELINES["greedy"](env)}
    reader = Checkpoints(run_dir.path)
    for update in reader.all():
        policies[str(update)] = learn.policy(env, config, reader.restore_weights(shapes, update))
    scores = evaluate_policies(env, params, policies, config.eval_episodes, config.seed)
    greedy = scores.pop("greedy")["return"]
    curve = [compare(int(n), own["return"], greedy, config.seed) for n, own in scores.items()]
    return float(greedy.mean()), curve
