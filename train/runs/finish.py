"""The end of a run: evaluation, picture and summary."""

import time
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from medjax.policies.policy import Policy
from medjax.policies.rules import BASELINES
from train.algorithms.networks import PolicyWeights, build_network
from train.algorithms.policy import learned_policy
from train.algorithms.ppo.learner import TrainState
from train.evaluation.scores import Evaluation, learned_names, summarize
from train.evaluation.tables import final_return, format_table
from train.export import export_policy
from train.reporting.figures import plot_curve
from train.runs.checkpoint import updates_done
from train.runs.logs import Row
from train.runs.run_directory import write_json
from train.runs.trained_run import TRAINED
from train.settings import TrainConfig

if TYPE_CHECKING:
    from train.runs.session import Session


def close_run(
    session: "Session",
    state: TrainState,
    rows: list[Row],
    wall_s: float,
    evaluate: bool,
) -> None:
    """Exports the policy, evaluates (unless told not to), draws the curve, and writes summary.json.

    Args:
        session: the run.
        state: where training ended, on the host.
        rows: all lines of metrics.jsonl.
        wall_s: seconds to the end of training, with compilation and resumed runs, without imports.
        evaluate: whether to evaluate.
    """
    config, run_dir = session.config, session.run_dir
    started = time.perf_counter()
    export_policy(run_dir.policy, session.env, session.params, config, state.weights)
    result = None
    if evaluate and config.eval_episodes:
        result = _evaluate(session, state)
        write_json(run_dir.evaluation, result)
        print(format_table(result, learned_names(result["policies"])), flush=True)
    returns = (
        {name: entry["return_mean"] for name, entry in result["policies"].items()} if result else {}
    )
    baselines = {name: value for name, value in returns.items() if name in BASELINES}
    try:
        title = f"PPO on {config.scenario}, {config.num_envs} environments"
        plot_curve(run_dir.plots / "training_curve.png", rows, title, baselines)
    except ImportError:
        print("no training curve: matplotlib is not installed", flush=True)
    final, source = final_return(rows), "training"
    if final is None and TRAINED in returns:
        final, source = returns[TRAINED], "evaluation"
    updates = updates_done(state)
    new_steps = (updates - session.done) * config.steps_per_update * config.num_seeds
    summary = {
        "scenario": config.scenario,
        "num_envs": config.num_envs,
        "num_seeds": config.num_seeds,
        "seed": config.seed,
        "updates": updates,
        "env_steps": updates * config.steps_per_update * config.num_seeds,
        "wall_s": round(wall_s, 3),
        "compile_s": round(session.compile_s, 3),  # of this process, as the next three are
        "train_s": round(session.train_s, 3),
        "env_steps_per_s": new_steps / session.train_s if session.train_s else 0.0,
        "evaluation_s": round(time.perf_counter() - started, 3),
        "final_return_mean": final,
        "final_return_from": source if final is not None else None,
        "evaluation_return_mean": returns,
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
    }
    write_json(run_dir.summary, summary)
    speed, steps = summary["env_steps_per_s"], summary["env_steps"]
    print(
        f"{steps} decisions in {wall_s:.1f} s, of which {session.compile_s:.1f} s compiling;"
        f" {speed:.0f} decisions/s while training. Results: {run_dir.path}",
        flush=True,
    )


def _evaluate(session: "Session", state: TrainState) -> dict[str, Any]:
    """The closing evaluation of the trained policies and the baselines."""
    env, config = session.env, session.config
    policies = all_policies(env, config, state.weights)
    print(
        f"evaluating {len(policies)} policies on {config.eval_episodes} episodes each", flush=True
    )
    scores = session.evaluation.result().play(policies, config.seed)
    return summarize(scores, config.scenario, learned_names(scores), config.seed)


def prepare_evaluation(
    env: Any, params: Any, config: TrainConfig, shapes: PolicyWeights
) -> Evaluation:
    """The closing evaluation of policies with weights of these shapes, compiled."""
    weights = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    return Evaluation(env, params, all_policies(env, config, weights), config.eval_episodes)


def all_policies(
    env: Any, config: TrainConfig, weights: PolicyWeights, stochastic: bool = False
) -> dict[str, Policy]:
    """The trained policy and every baseline, by name.

    With several seeds `ppo` is the first's and `ppo_seed2`, ... are the others'.

    Args:
        env: a single environment.
        config: settings of the run.
        weights: of the run, with a leading axis if it had several seeds.
        stochastic: sample the trained policy's actions.
    """
    network = build_network(env, config)
    policies = {}
    for index in range(config.num_seeds):
        own = (
            jax.tree.map(lambda leaf, i=index: leaf[i], weights)
            if config.num_seeds > 1
            else weights
        )
        policies[TRAINED if index == 0 else f"{TRAINED}_seed{index + 1}"] = learned_policy(
            env, network, own, config.decide_every, stochastic
        )
    return policies | {name: build(env) for name, build in BASELINES.items()}
