"""Sentences that state what a figure shows, each with the 95 % interval that it rests on."""

import numpy as np

from train.evaluation.statistics import FEWEST, bootstrap_ci95
from train.evaluation.tables import interval, short


def difference(what: str, names: tuple[str, str], gains: np.ndarray, seed: int) -> str:
    """States whether two policies differ in a quantity, from its gains `(episodes,)` of the first over the second."""
    ours, theirs = names
    episodes = f"{len(gains)} episodes"
    if not np.any(gains):
        return f"{what}: {ours} and {theirs} are the same in each of the {episodes}."
    if len(gains) < FEWEST:
        return f"{what}: {episodes} are too few to tell {ours} from {theirs}."
    low, high = bootstrap_ci95(gains, seed)
    given = f"{_signed(float(np.mean(gains)))} {interval((low, high))}"
    if low <= 0.0 <= high:
        return f"{what}: no difference between {ours} and {theirs} can be seen with {episodes}, {given}."
    side = "higher" if low > 0.0 else "lower"
    return f"{what}: {side} with {ours} than with {theirs} in the same {episodes}, {given}."


def learning(returns: np.ndarray, seed: int) -> str:
    """States whether mean returns `(updates,)` rise from the first to the last quarter, and from the third.

    A change counts if the interval of the difference of means excludes 0.
    """
    size = len(returns) // 4
    if size < FEWEST:
        return (
            f"{len(returns)} updates in which an episode ended are too few to tell a trend, {4 * FEWEST} are needed: "
            "the comparison below says what was learned."
        )
    last = returns[-size:]
    whole = _trend(last - returns[:size], seed, "rises")
    late = _trend(last - returns[-2 * size : -size], seed, "still rises")
    quarters = "from the first to the last quarter of the updates"
    return f"The return {whole} {quarters}, and {late} from the third to the last."


def counts(what: str, here: float, samples: np.ndarray, seed: int) -> str:
    """States the count in the episode shown beside the mean of the counts in all, `(episodes,)`."""
    mean = f"{short(float(np.mean(samples)))} {interval(bootstrap_ci95(samples, seed))}"
    return f"{what}: {here:.0f} in this episode, {mean} in the mean of {len(samples)}."


def _trend(gains: np.ndarray, seed: int, rises: str) -> str:
    """The word for up, down or neither, with the mean and its interval."""
    low, high = bootstrap_ci95(gains, seed)
    word = rises if low > 0.0 else "falls" if high < 0.0 else "does not change visibly"
    return f"{word} ({_signed(float(np.mean(gains)))} {interval((low, high))})"


def _signed(value: float) -> str:
    return ("+" if value > 0.0 else "") + short(value)
