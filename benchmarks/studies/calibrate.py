"""`python -m benchmarks.calibrate`: the reward weights that reproduce the paper's Table 2, without PPO.

The paper prints neither the weights nor the penalty. Table 2 gives the mean episode reward of "no action" and "random
choice". These two numbers determine two unknowns: the penalty w1 of a depleted EV, and a common factor of the other
weights of eq (10). Returns are linear in the weights, so both follow from episodes of these two policies.
"""

import argparse
from typing import Any

import numpy as np

import medjax
from benchmarks.command import episodes_parser, run_command
from benchmarks.studies.base import rules
from medjax.episodes.scores import Evaluation, Scores
from medjax.errors import InputError
from train.evaluation.tables import PAPER_TABLE_2

# Mean and standard deviation of the episode reward over ten episodes.
TABLE_2 = {name: PAPER_TABLE_2[name] for name in ("none", "random")}


def without_penalty(score: Scores, penalty: float) -> np.ndarray:
    """Returns `(episodes,)` without the cost of depleted EVs, which is `penalty` each."""
    return score["return"] + penalty * score["evs_depleted"]


def solve(scores: dict[str, Scores], penalty: float) -> tuple[float, float]:
    """The factor of the other weights, and w1, for which both means equal the paper's.

    Args:
      scores: of episodes played under known weights.
      penalty: w1 among these weights, positive.
    """
    rows = [
        [without_penalty(scores[name], penalty).mean(), -scores[name]["evs_depleted"].mean()]
        for name in TABLE_2
    ]
    factor, w1 = np.linalg.solve(np.array(rows), [mean for mean, _ in TABLE_2.values()])
    return float(factor), float(w1)


def compare(scores: dict[str, Scores]) -> list[dict[str, Any]]:
    """The paper's mean and deviation beside ours, and the distance of the means in the paper's deviations."""
    table: list[dict[str, Any]] = []
    for name, (mean, std) in TABLE_2.items():
        returns = scores[name]["return"]
        ours = {"mean": float(returns.mean()), "std": float(returns.std(ddof=1))}
        standardized_difference = float(abs(returns.mean() - mean) / std)
        paper = {"policy": name, "paper_mean": mean, "paper_std": std}
        table.append({**paper, **ours, "deviations_apart": standardized_difference})
    return table


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Prints the fitted weights, and Table 2 for the preset's own weights on other episodes."""
    env, params = medjax.make(options.scenario)
    policies = rules(env, TABLE_2)
    weights = {name: float(value) for name, value in params.reward_weights.items()}
    if not weights.get("depleted"):
        raise InputError(
            f"--scenario {options.scenario}: allowed one that pays for EVs that run out"
        )
    evaluation = Evaluation(env, params, policies, options.episodes)
    factor, w1 = solve(evaluation.play(policies, options.seed), -weights["depleted"])
    print(f"weights that fit episodes of seed {options.seed}, and the preset's own:")
    best = {name: factor * value for name, value in weights.items() if value} | {"depleted": -w1}
    for name, value in best.items():
        print(f"  {name:<10} {value:9.4f} {weights[name]:9.4f}")
    table = compare(evaluation.play(policies, options.seed + 1))
    print(f"\nthe preset's weights on episodes of seed {options.seed + 1}, Table 2 beside them:")
    print("policy        mean      std    paper's    its std   its deviations apart")
    for row in table:
        print(
            f"{row['policy']:<8} {row['mean']:9.1f} {row['std']:8.1f} {row['paper_mean']:10.1f}"
            f" {row['paper_std']:10.1f} {row['deviations_apart']:22.2f}"
        )
    return {"weights": best, "episodes": options.episodes, "table_2": table}


def main(arguments: list[str] | None = None) -> None:
    parser = episodes_parser("calibrate", __doc__, episodes=1024, seed=1)
    run_command(parser, measure, arguments)
