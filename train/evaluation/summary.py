"""Summarises scores of policies: means, their intervals, and the gains of learned policies over the others."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from medjax.env.reward import REWARDS
from medjax.episodes.scores import Scores
from medjax.episodes.verdict import LINES, NAMES
from medjax.policies.rules import BASELINES
from medjax.scenarios import SCENARIOS
from train.evaluation.statistics import (
    bootstrap_ci95,
    interquartile_mean,
    plain,
    relative_change,
    seeds_ci95,
)
from train.evaluation.tables import SAMPLED, START, TERM

CLAIMED = ("depleted_share", "mean_range_m", "mean_soc")  # the paper compares these with no action


def learned_names(names: Iterable[str]) -> list[str]:
    """The names of learned policies that take the most probable action: no rules, initial policies or samplers."""
    others = {*BASELINES, START}
    return [name for name in names if name not in others and not name.endswith(SAMPLED)]


def returns_of_rules(result: Mapping[str, Any]) -> dict[str, float]:
    """The finite mean returns of the policies that are not learned, by name; `result` is of `summarize`."""
    entries = result["policies"]
    returns = {
        name: entries[name]["return_mean"] for name in entries if name not in learned_names(entries)
    }
    return {name: mean for name, mean in returns.items() if mean is not None}


def summarize(
    scores: Mapping[str, Scores],
    scenario: str,
    learned: Collection[str],
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
    baseline: str | None = None,
) -> dict[str, Any]:
    """The JSON of `train.evaluate`.

    Args:
        scores: scores of `medjax.episodes.scores.evaluate_policies`.
        scenario: name of the preset.
        learned: names of the learned policies, one per training seed of one algorithm.
        seed: seed of the episodes and of the bootstrap.
        overrides: changes to the preset, `TrainConfig.changes`.
        baseline: policy to compare the others with.

    Returns:
        Always `episodes`, `scenario`, `overrides`, `seed` and `policies`. The last has by name `return_mean`,
        `return_std`, `return_ci95`, `verdict_ci95`, and the mean of every metric. None replaces numbers and ends of
        intervals that are not finite. If the reward's terms differ from the preset's, `reward` lists their names. A
        baseline adds `baseline` and `difference_from_baseline`: `mean` and `ci95` of each other policy's return minus
        the baseline's in the same episode. Learned policies add two comparisons of an episode's mean over the training
        seeds, each `mean` and `ci95`: `paired_return_difference` from every other policy, and `change_against_none` of
        metrics, as a share. Several training seeds add `training_seeds`: `return_means`, `interquartile_mean`, `ci95`,
        and each learner's own `paired_return_differences`. Intervals are over episodes; those of a mean over training
        seeds also over seeds, and `training_seeds.ci95` over seeds alone.
    """
    result: dict[str, Any] = {
        "policies": {name: _entry(score, seed) for name, score in scores.items()},
        "episodes": int(next(iter(scores.values()))["return"].size),
        "scenario": scenario,
        "overrides": dict(overrides or {}),
        "seed": seed,
        **_other_reward(scenario, scores),
    }
    if baseline is not None:
        result |= {
            "baseline": baseline,
            "difference_from_baseline": _differences_from(baseline, scores, seed),
        }
    trained = [score for name, score in scores.items() if name in learned]
    rules = {name: score for name, score in scores.items() if name not in learned}
    if trained:
        ours = {column: np.stack([score[column] for score in trained]) for column in trained[0]}
        result |= _compare(ours, rules, seed)
    if len(trained) > 1:
        means = np.mean([score["return"] for score in trained], axis=1)
        result["training_seeds"] = {
            "return_means": [*map(plain, means)],
            "interquartile_mean": plain(interquartile_mean(means[None])[0]),
            "ci95": [*map(plain, bootstrap_ci95(means, seed, statistic=interquartile_mean))],
            "paired_return_differences": [
                _gains(score["return"][None], rules, seed) for score in trained
            ],
        }
    return result


def _differences_from(
    baseline: str, scores: Mapping[str, Scores], seed: int
) -> dict[str, dict[str, Any]]:
    """`mean` and `ci95` of each other policy's return minus the baseline's in the same episode, by name."""
    base = {baseline: scores[baseline]}
    return {
        name: _gains(score["return"][None], base, seed)[baseline]
        for name, score in scores.items()
        if name != baseline
    }


def _other_reward(scenario: str, scores: Mapping[str, Scores]) -> dict[str, list[str]]:
    """The terms of the reward as `reward`, if they differ from the preset's."""
    columns = dict.fromkeys(column for score in scores.values() for column in score)
    terms = [name.removeprefix(TERM) for name in columns if name.startswith(TERM)]
    usual = REWARDS[SCENARIOS[scenario].reward] if scenario in SCENARIOS else terms
    return {"reward": terms} if terms and set(terms) != set(usual) else {}


def _entry(score: Scores, seed: int) -> dict[str, Any]:
    returns = score["return"]
    return {
        "return_mean": plain(float(np.mean(returns))),
        "return_std": plain(float(np.std(returns, ddof=1))) if returns.size > 1 else 0.0,
        "return_ci95": [*map(plain, bootstrap_ci95(returns, seed))],
        "verdict_ci95": verdict_ci95(score, seed),
        **{
            ("episode_length" if column == "length" else column): plain(float(np.mean(values)))
            for column, values in score.items()
            if column != "return"
        },
    }


def verdict_ci95(score: Scores, seed: int = 0) -> dict[str, list[float]]:
    """Intervals of the lines of the player's verdict by title, except the return and what is not finite."""
    if not {*NAMES} - {"return_mean"} <= {*score}:  # another kind of environment
        return {}
    lines = [line for line in LINES if line.title != "return"]
    ends = {line.title: list(bootstrap_ci95(line.of(score), seed)) for line in lines}
    return {title: pair for title, pair in ends.items() if np.isfinite(pair).all()}


def _compare(ours: Scores, rules: Mapping[str, Scores], seed: int) -> dict[str, Any]:
    """Compares the learned policies, arrays `(seeds, episodes)`, with the rules by episode; see `summarize`."""
    result: dict[str, Any] = {"paired_return_difference": _gains(ours["return"], rules, seed)}
    base = rules.get("none", {})
    changes = {}
    for metric in [name for name in CLAIMED if name in base]:
        pairs = np.stack(np.broadcast_arrays(ours[metric], base[metric]), axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = seeds_ci95(pairs, seed, statistic=relative_change)
        if np.isfinite(ends).all():  # not if "none" gives 0 in every drawn episode
            change = float(relative_change(pairs.mean(axis=0)[None])[0])
            changes[metric] = {"mean": change, "ci95": list(ends)}
    return result | ({"change_against_none": changes} if changes else {})


def _gains(returns: np.ndarray, rules: Mapping[str, Scores], seed: int) -> dict[str, Any]:
    """Returns `(seeds, episodes)` minus those of each rule in the same episode: `mean`, `ci95`."""
    gains = {name: returns - score["return"] for name, score in rules.items()}
    return {
        name: {"mean": plain(np.mean(gain)), "ci95": [*map(plain, seeds_ci95(gain, seed))]}
        for name, gain in gains.items()
    }
