"""Sentences that state what a figure shows; each that compares has the 95 % interval that it rests on."""

from collections.abc import Mapping, Sequence

import numpy as np

from train.evaluation.statistics import FEWEST, bootstrap_ci95
from train.evaluation.tables import interval, short


def difference(what: str, names: tuple[str, str], gains: np.ndarray, seed: int) -> str:
    """States whether two policies differ in the same episodes.

    Args:
        what: the quantity, with its unit.
        names: names of the policy and of the one that it is compared with.
        gains: (episodes,) the first policy's number minus the second's.
        seed: seed of the bootstrap.

    Returns:
        The sentence.
    """
    ours, theirs = names
    episodes = f"{len(gains)} episodes"
    if not np.any(gains):
        return f"{what}: {ours} and {theirs} are the same in each of the {episodes}."
    if len(gains) < FEWEST:
        return f"{what}: {episodes} are too few to tell {ours} from {theirs}."
    if not np.isfinite(gains).all():
        return f"{what}: it is not finite in some of the {episodes}."
    low, high = bootstrap_ci95(gains, seed)
    given = f"{_signed(float(np.mean(gains)))} {interval((low, high))}"
    if low <= 0.0 <= high:
        return f"{what}: no difference between {ours} and {theirs} can be seen with {episodes}, {given}."
    side = "higher" if low > 0.0 else "lower"
    return f"{what}: {side} with {ours} than with {theirs} in the same {episodes}, {given}."


def reached(shares: Mapping[str, float], stops: Mapping[str, float]) -> str:
    """States how many EVs of a hundred reach their exit, and how many leave before it to charge.

    Args:
        shares: share of the EVs that reach their exit, in [0, 1], by what is done, such as "with the trained policy".
        stops: share that breaks off the trip to charge, likewise. Where it is none of a hundred it is not said.

    Returns:
        The sentence.
    """
    leave = {done: round(100.0 * share) for done, share in stops.items()}
    cases: list[str] = []
    for done, share in shares.items():
        here = f"{100.0 * share:.0f}"
        if not cases or any(leave.values()):
            here += " reach their exit"
        if leave[done]:
            here += f" and {leave[done]} leave to charge"
        cases.append(f"{here} {done}")
    return f"Of 100 electric vehicles (EVs), {_listed(cases)}."


def lost(minutes: Mapping[str, float], duration: str) -> str:
    """States how much time the other drivers lose in an episode.

    Args:
        minutes: time that all of them lose together, by what is done, as in `reached`.
        duration: of the episode.

    Returns:
        The sentence.
    """
    cases = [f"{_amount(each)} min {done}" for done, each in minutes.items()]
    return f"In an episode of {duration}, the drivers of all other vehicles together lose {_listed(cases)}."


def learning(returns: np.ndarray) -> str:
    """States how a learning curve goes, as it was drawn.

    It gives the means of the first quarter of the updates and of the last two, or of halves where quarters are too
    short. It says neither an interval nor whether a change is sure, because the updates of a run depend on each other.

    Args:
        returns: (updates,) mean returns in order.

    Returns:
        The sentence.
    """
    quarter, half = len(returns) // 4, len(returns) // 2
    if half < FEWEST:
        return (
            f"{len(returns)} updates in which an episode ended are too few to tell a trend, {2 * FEWEST} are needed: "
            "the comparison below says what was learned."
        )
    if quarter < FEWEST:
        first, last = _mean(returns[:half]), _mean(returns[-half:])
        return (
            f"The mean return is {first} in the first half of the updates and {last} in the second."
        )
    first, third = _mean(returns[:quarter]), _mean(returns[-2 * quarter : -quarter])
    return (
        f"The mean return is {first} in the first quarter of the updates, {third} in the third and "
        f"{_mean(returns[-quarter:])} in the last."
    )


def counts(what: str, here: float, samples: np.ndarray, seed: int) -> str:
    """States an episode's count beside the mean of all episodes.

    Args:
        what: what is counted.
        here: count in the episode shown.
        samples: (episodes,) count in each.
        seed: seed of the bootstrap.

    Returns:
        The sentence.
    """
    mean = f"{short(float(np.mean(samples)))} {interval(bootstrap_ci95(samples, seed))}"
    return f"{what}: {here:.0f} in this episode, {mean} in the mean of {len(samples)}."


def _mean(returns: np.ndarray) -> str:
    return short(float(np.mean(returns)))


def _listed(cases: Sequence[str]) -> str:
    """Two cases or more in one sentence."""
    return f"{', '.join(cases[:-1])}, and {cases[-1]}"


def _amount(value: float) -> str:
    """A number with a digit after the point if it is below 10; never -0."""
    digits = 0 if abs(value) >= 10.0 else 1
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _signed(value: float) -> str:
    return ("+" if value > 0.0 else "") + short(value)
