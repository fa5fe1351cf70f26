"""What the episodes of one point of the map say: who is best there, and by how much."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from train.evaluation.statistics import bootstrap_ci95

Scores = Mapping[str, np.ndarray]  # by metric, `(episodes,)` each


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The best dispatcher of a point, beside the best way of doing without MEDs."""

    best: str
    control: str
    gain_mean: float  # EUR an hour
    gain_ci95: tuple[float, float]
    kwh: float  # delivered, an hour
    stops_spared: float  # an hour
    delay_h: float  # everybody's, an hour, more than the control's

    @property
    def pays(self) -> str:
        """`yes` or `no` where the interval leaves no doubt, else `open`."""
        low, high = self.gain_ci95
        return "yes" if low > 0.0 else "no" if high < 0.0 else "open"


def at_prices(score: Scores, terms: Mapping[str, float]) -> np.ndarray:
    """Returns of episodes with other prices, `(episodes,)`.

    Args:
      score: with `return` and `reward_NAME` of each term.
      terms: new price over old price by term.
    """
    changes = [(factor - 1.0) * score[f"reward_{term}"] for term, factor in terms.items()]
    return np.sum([score["return"], *changes], axis=0)


def best_of(returns: Mapping[str, np.ndarray], among: Sequence[str], rows: np.ndarray) -> str:
    """The policy with the highest mean return in these episodes."""
    return max(among, key=lambda name: float(returns[name][rows].mean()))


def gains(
    returns: Mapping[str, np.ndarray], dispatchers: Sequence[str], controls: Sequence[str]
) -> np.ndarray:
    """What the best dispatcher gains on the best control, `(episodes,)`.

    Who is best is chosen on the other half of the episodes, so that luck in choosing does not count as a gain.
    """
    every = np.arange(len(next(iter(returns.values()))))
    found = np.empty(len(every))
    for half in (every % 2 == 0, every % 2 == 1):
        best, control = (best_of(returns, among, ~half) for among in (dispatchers, controls))
        found[half] = returns[best][half] - returns[control][half]
    return found


def judge(
    scores: Mapping[str, Scores],
    controls: Sequence[str],
    terms: Mapping[str, float],
    hours: float,
    seed: int,
) -> Verdict:
    """The verdict on one point.

    Args:
      scores: of all policies on the same episodes, at least two.
      controls: names of those that send no MED.
      terms: as in `at_prices`.
      hours: of an episode.
      seed: of the bootstrap.
    """
    returns = {name: at_prices(score, terms) for name, score in scores.items()}
    dispatchers = [name for name in scores if name not in controls]
    gain = gains(returns, dispatchers, controls) / hours
    every = np.arange(len(gain))
    best, control = (best_of(returns, among, every) for among in (dispatchers, controls))

    def more(*metrics: str) -> float:
        """By how much the best dispatcher has more of these than the control, an hour."""
        each = [scores[best][metric] - scores[control][metric] for metric in metrics]
        return float(np.sum(each, axis=0).mean()) / hours

    return Verdict(
        best=best,
        control=control,
        gain_mean=float(gain.mean()),
        gain_ci95=bootstrap_ci95(gain, seed),
        kwh=more("energy_delivered_kwh"),
        # Who leaves for a charger, or passes the road's end with so little that it must stop soon.
        stops_spared=-more("low_exits"),
        delay_h=more("ev_delay_h", "gas_delay_h"),
    )
