"""Intervals against closed forms and SciPy."""

import numpy as np
import pytest
from scipy import stats

from train.evaluation.statistics import bootstrap_ci95, interquartile_mean, relative_change


def test_bootstrap_is_the_normal_interval_for_many_samples():
    samples = np.random.default_rng(0).normal(3.0, 2.0, 2000)
    low, high = bootstrap_ci95(samples)
    half = 1.96 * samples.std() / np.sqrt(samples.size)
    assert low == pytest.approx(samples.mean() - half, abs=0.03 * half)
    assert high == pytest.approx(samples.mean() + half, abs=0.03 * half)


def test_bootstrap_equals_scipys_for_few_skewed_samples():
    samples = np.random.default_rng(1).exponential(size=25)
    expected = stats.bootstrap(
        (samples,), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(2)
    ).confidence_interval
    got = bootstrap_ci95(samples)
    width = expected.high - expected.low
    np.testing.assert_allclose(got, expected, atol=0.04 * width)
    assert bootstrap_ci95(samples) == got
    assert bootstrap_ci95(np.full(5, 2.0)) == (2.0, 2.0)
    assert np.isnan(bootstrap_ci95(np.zeros(0))).all()


def test_the_interval_of_a_relative_change_is_scipys():
    rng = np.random.default_rng(3)
    base = rng.normal(10.0, 2.0, 80)
    pairs = np.stack([0.4 * base + rng.normal(0.0, 0.5, 80), base], axis=1)
    expected = stats.bootstrap(
        tuple(pairs.T),
        lambda ours, theirs, axis: ours.mean(axis) / theirs.mean(axis) - 1.0,
        paired=True,
        n_resamples=20_000,
        method="percentile",
        rng=np.random.default_rng(2),
    ).confidence_interval
    got = bootstrap_ci95(pairs, statistic=relative_change)
    np.testing.assert_allclose(got, expected, atol=0.04 * (expected.high - expected.low))


@pytest.mark.parametrize("size", [1, 3, 4, 7, 8])
def test_interquartile_mean_is_scipys_trimmed_mean(size):
    samples = np.random.default_rng(size).exponential(size=(5, size))
    expected = stats.trim_mean(samples, 0.25, axis=1)
    np.testing.assert_allclose(interquartile_mean(samples), expected, rtol=1e-12)
