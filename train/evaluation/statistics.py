"""Bootstrap confidence intervals."""

import math
from collections.abc import Callable

import numpy as np

NUM_RESAMPLES = 10_000
FEWEST = 8  # samples; with fewer, bootstrap intervals are much too narrow to draw conclusions
BLOCK = 2**22  # numbers drawn at once, 32 MiB


def plain(value: float) -> float | None:
    """A number for JSON; None replaces what is not finite, because JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def mean(samples: np.ndarray) -> np.ndarray:
    """Mean over axis 1."""
    return np.asarray(np.mean(samples, axis=1))


def relative_change(samples: np.ndarray) -> np.ndarray:
    """Relative change from the mean of the second column to that of the first; `(rows, n, 2)` to `(rows,)`."""
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
        samples: `(n, ...)`, independent.
        seed: seed of the resampling, which makes tables reproducible.
        num_resamples: number of resamples.
        statistic: `(rows, n, ...) -> (rows,)`.

    Returns:
        Lower and upper end, NaN if n is 0.
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
    """95 % percentile interval of a mean over training seeds that all played the same episodes.

    It resamples seeds and episodes independently, since an episode is the same for all seeds (the pigeonhole bootstrap:
    Owen 2007, arXiv:0711.0789). With fewer seeds than `FEWEST` the interval is coarse and too narrow.

    Args:
        samples: `(seeds, n, ...)`, a row per training seed; for one seed the result is `bootstrap_ci95` of the row.
        seed, num_resamples, statistic: as in `bootstrap_ci95`; the statistic takes means over the seeds drawn.

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


def improvement_probability(
    new: np.ndarray, old: np.ndarray, seed: int = 0, num_resamples: int = NUM_RESAMPLES
) -> tuple[float, tuple[float, float]]:
    """Probability that a run of one kind is better than a run of another; a tie counts half (Agarwal et al. 2021).

    With fewer runs than `FEWEST` the interval is too narrow. It has no width if each run of one kind beats all of the
    other, which chance alone does to three and three once in ten times, one way or the other.

    Args:
        new, old: `(seeds,)` each, a result per run; the numbers of runs may differ.
        seed, num_resamples: of the bootstrap, which draws the runs of both kinds.

    Returns:
        The probability, and the lower and upper end of its 95 % interval.
    """
    gains = np.asarray(new, np.float64)[:, None] - np.asarray(old, np.float64)
    wins = (gains > 0.0) + 0.5 * (gains == 0.0)
    rng, (count, others) = np.random.default_rng(seed), wins.shape

    def draw(rows: int) -> np.ndarray:
        first = rng.integers(0, count, (rows, count, 1))
        second = rng.integers(0, others, (rows, 1, others))
        return np.asarray(np.mean(wins[first, second], axis=(1, 2)))

    return float(wins.mean()), _percentiles(draw, wins.size, num_resamples)


def _percentiles(
    draw: Callable[[int], np.ndarray], size: int, num_resamples: int
) -> tuple[float, float]:
    """Ends of the middle 95 % of the statistics; `draw` gives some rows of `size` numbers at a time."""
    rows = max(1, BLOCK // size)
    drawn = [draw(min(rows, num_resamples - first)) for first in range(0, num_resamples, rows)]
    low, high = np.percentile(np.concatenate(drawn), [2.5, 97.5])
    return float(low), float(high)
