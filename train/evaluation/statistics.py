"""Confidence intervals by the bootstrap."""

import math
from collections.abc import Callable

import numpy as np

NUM_RESAMPLES = 10_000
FEWEST = 8  # samples; the bootstrap's interval of fewer is much too narrow to conclude from
BLOCK = 2**22  # numbers drawn at once, 32 MiB of them


def plain(value: float) -> float | None:
    """A number for JSON, which has no NaN: None stands for "there was none"."""
    return float(value) if math.isfinite(value) else None


def mean(samples: np.ndarray) -> np.ndarray:
    """Over axis 1."""
    return np.asarray(np.mean(samples, axis=1))


def relative_change(samples: np.ndarray) -> np.ndarray:
    """By how much the mean of the first of two is above that of the second, as a share; `(rows, n, 2)` to `(rows,)`."""
    means = np.mean(samples, axis=1)
    return np.asarray(means[:, 0] / means[:, 1] - 1.0)


def interquartile_mean(samples: np.ndarray) -> np.ndarray:
    """Mean over axis 1 without the lowest and highest quarter, rounded down (Agarwal et al. 2021, arXiv:2108.13264)."""
    cut = samples.shape[1] // 4
    return mean(np.sort(samples, axis=1)[:, cut : samples.shape[1] - cut])


def bootstrap_ci95(
    samples: np.ndarray,
    seed: int = 0,
    num_resamples: int = NUM_RESAMPLES,
    statistic: Callable[[np.ndarray], np.ndarray] = mean,
) -> tuple[float, float]:
    """95 % percentile interval of a statistic (Efron and Tibshirani 1993, section 13.3).

    Args:
        samples: `(n, ...)`, independent; NaN if n is 0.
        seed: of the resampling, so that a table can be had again.
        num_resamples: statistics drawn.
        statistic: `(rows, n, ...) -> (rows,)`.

    Returns:
        Lower and upper end.
    """
    samples = np.asarray(samples, np.float64)
    size = samples.shape[0]
    if size == 0:
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)

    def draw(rows: int) -> np.ndarray:
        return statistic(samples[rng.integers(0, size, (rows, size))])

    return _percentiles(draw, samples.size, num_resamples)


def seeds_ci95(
    samples: np.ndarray,
    seed: int = 0,
    num_resamples: int = NUM_RESAMPLES,
    statistic: Callable[[np.ndarray], np.ndarray] = mean,
) -> tuple[float, float]:
    """The same of a mean over training seeds that all played the same episodes: seeds are drawn anew, and episodes.

    Each is drawn by itself, since an episode is the same for all seeds (the pigeonhole bootstrap: Owen 2007,
    arXiv:0711.0789). Of few seeds it is coarse, and narrower than 95 % takes: `FEWEST`.

    Args:
        samples: `(seeds, n, ...)`, a row a training seed; of one seed it is `bootstrap_ci95` of the row.
        seed, num_resamples, statistic: of `bootstrap_ci95`; the statistic is of means over the seeds drawn.

    Returns:
        Lower and upper end.
    """
    samples = np.asarray(samples, np.float64)
    num_seeds, size = samples.shape[:2]
    if num_seeds == 1:
        return bootstrap_ci95(samples[0], seed, num_resamples, statistic)
    rng = np.random.default_rng(seed)

    def draw(rows: int) -> np.ndarray:
        seeds = rng.integers(0, num_seeds, (rows, num_seeds, 1))
        episodes = rng.integers(0, size, (rows, 1, size))
        return statistic(np.mean(samples[seeds, episodes], axis=1))

    return _percentiles(draw, samples.size, num_resamples)


def _percentiles(
    draw: Callable[[int], np.ndarray], size: int, num_resamples: int
) -> tuple[float, float]:
    """Ends of the middle 95 % of statistics, drawn some rows of `size` numbers at a time."""
    rows = max(1, BLOCK // size)
    drawn = [draw(min(rows, num_resamples - first)) for first in range(0, num_resamples, rows)]
    low, high = np.percentile(np.concatenate(drawn), [2.5, 97.5])
    return float(low), float(high)
