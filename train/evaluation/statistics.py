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
    rows = max(1, BLOCK // samples.size)
    drawn = [
        statistic(samples[rng.integers(0, size, (min(rows, num_resamples - first), size))])
        for first in range(0, num_resamples, rows)
    ]
    low, high = np.percentile(np.concatenate(drawn), [2.5, 97.5])
    return float(low), float(high)
