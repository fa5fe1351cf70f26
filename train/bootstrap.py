"""Confidence intervals of means by the bootstrap."""

import numpy as np

NUM_RESAMPLES = 10_000
BLOCK = 2**22  # numbers drawn at once, 32 MiB of them


def bootstrap_ci95(
    samples: np.ndarray, seed: int = 0, num_resamples: int = NUM_RESAMPLES
) -> tuple[float, float]:
    """95 % percentile interval of the mean (Efron and Tibshirani 1993, section 13.3).

    Args:
        samples: `(n,)`, independent; NaN if n is 0.
        seed: of the resampling, so that a table can be had again.
        num_resamples: means drawn.

    Returns:
        Lower and upper end.
    """
    samples = np.asarray(samples, np.float64)
    size = samples.shape[0]
    if size == 0:
        return float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    rows = max(1, BLOCK // size)
    means = []
    for first in range(0, num_resamples, rows):
        picks = rng.integers(0, size, (min(rows, num_resamples - first), size))
        means.append(samples[picks].mean(axis=1))
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return float(low), float(high)
