"""The bins that dispatches are drawn in."""

import numpy as np

from train.reporting.diagrams import _in_bins


def test_bins_of_time_keep_the_total():
    values = np.random.default_rng(0).random((10, 2))
    edges = np.array([0, 4, 8, 10])
    means = _in_bins(values, edges)
    np.testing.assert_allclose((means * np.diff(edges)[:, None]).sum(axis=0), values.sum(axis=0))
    np.testing.assert_allclose(means[2], values[8:].mean(axis=0))
