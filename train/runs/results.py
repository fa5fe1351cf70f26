"""The results of a finished training: the policy, its evaluation, the training curve and a summary."""

import dataclasses
import time
from concurrent.futures import Future
from typing import Any

import jax
import numpy as np

from medjax.episodes.scores import Evaluation
from medjax.files import write_json
from train.algorithms.networks import PolicyWeights
from train.evaluation.comparison import Comparison
from train.evaluation.summary import learned_names, returns_of_rules, summarize
from train.reporting.figures import plot_curve
from train.runs.logs import Row, final_return
from train.runs.policies import all_policies, export_policy
from train.runs.run_directory import RunDir
from train.settings import TrainConfig


@dataclasses.dataclass(frozen=True)
class Trained:
    """A run whose training has ended."""

    env: Any  # a single environment
    params: Any  # its parameters
    config: TrainConfig
    run_dir: RunDir  # receives the results
    weights: PolicyWeights  # learned weights, on the host
    rows: list[Row]  # all rows of metrics.jsonl
    updates: int  # done in total
    new_updates: int  # done by this process
    wall_s: float  # to the end of training, with compilation and earlier parts, without imports
    compile_s: float  # of this process
    train_s: float  # of this process
    played: Comparison | None = None  # the closing evaluation


def prepare_evaluation(
    env: Any, params: Any, config: TrainConfig, shapes: PolicyWeights
) -> Evaluation:
    """The closing evaluation, compiled for policies with weights of these shapes."""
    weights = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    return Evaluation(env, params, all_policies(env, config, weights), config.eval_episodes)


def write_results(run: Trained, evaluation: Future[Evaluation] | None) -> Comparison | None:
    """Exports the policy, plays the `evaluation` if there is one, draws the curve, and writes summary.json.

    Returns:
        The evaluation.
    """
    started = time.perf_counter()
    _export(run)  # the policy is there even if the evaluation fails
    played = None
    if evaluation is not None:
        played = _evaluate(run, evaluation)
        _export(run)  # the file includes the evaluation
    entries = played.result["policies"] if played is not None else {}
    returns = {name: entry["return_mean"] for name, entry in entries.items()}
    rules = {} if played is None else returns_of_rules(played.result)
    try:
        plot_curve(run.run_dir.plots / "training_curve.png", run.rows, run.config, rules)
    except ImportError:
        print("no training curve: matplotlib is not installed", flush=True)
    summary = _summary(run, returns) | {"evaluation_s": round(time.perf_counter() - started, 3)}
    write_json(run.run_dir.summary, summary)
    speed, steps = summary["env_steps_per_s"], summary["env_steps"]
    print(
        f"{steps} decisions in {run.wall_s:.1f} s, of which {run.compile_s:.1f} s compiling;"
        f" {speed:.0f} decisions/s while training. Results: {run.run_dir.path}",
        flush=True,
    )
    return played


def _export(run: Trained) -> None:
    learned = run.env, run.params, run.config, run.weights
    export_policy(run.run_dir.policy, *learned, run.run_dir.card(), given=run.run_dir.given)


def _evaluate(run: Trained, evaluation: Future[Evaluation]) -> Comparison:
    config, policies = run.config, all_policies(run.env, run.config, run.weights)
    of_each = f"{config.eval_episodes} episodes each"
    print(f"evaluating {len(policies)} policies on {of_each}", flush=True)
    scores = evaluation.result().play(policies, config.seed)
    learned = learned_names(scores)
    result = summarize(scores, config.scenario, learned, config.seed, config.changes)
    write_json(run.run_dir.evaluation, result)
    played = Comparison(result, scores, learned)
    print(played, flush=True)
    return played


def _summary(run: Trained, returns: dict[str, float | None]) -> dict[str, Any]:
    config = run.config
    steps = config.steps_per_update * config.num_seeds
    final, source = final_return(run.rows), "training"
    if final is None and config.algorithm in returns:
        final, source = returns[config.algorithm], "evaluation"
    return {
        "scenario": config.scenario,
        "num_envs": config.num_envs,
        "num_seeds": config.num_seeds,
        "seed": config.seed,
        "updates": run.updates,
        "env_steps": run.updates * steps,
        "wall_s": round(run.wall_s, 3),
        "compile_s": round(run.compile_s, 3),  # this process only, like train_s and env_steps_per_s
        "train_s": round(run.train_s, 3),
        "env_steps_per_s": run.new_updates * steps / run.train_s if run.train_s else 0.0,
        "final_return_mean": final,
        "final_return_from": source if final is not None else None,
        "evaluation_return_mean": returns,
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
    }
