"""Intervals against closed forms and SciPy."""

from itertools import product

import numpy as np
import pytest
from scipy import stats

from train.evaluation.statistics import (
    bootstrap_ci95,
    interquartile_mean,
    relative_change,
    seeds_ci95,
)


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


def test_the_interval_over_seeds_and_episodes_is_the_closed_form():
    """For the sum of a number of the seed and one of the episode, the variances of both means add up."""
    rng = np.random.default_rng(4)
    for seeds, episodes in ((3.0, 0.1), (0.1, 3.0), (2.0, 12.0)):
        own, common = rng.normal(0.0, seeds, 30), rng.normal(0.0, episodes, 150)
        samples = own[:, None] + common
        low, high = seeds_ci95(samples)
        half = 1.96 * np.sqrt(own.var() / own.size + common.var() / common.size)
        middle = samples.mean()
        assert (low, high) == pytest.approx((middle - half, middle + half), abs=0.05 * half)


@pytest.mark.parametrize("statistic", [None, relative_change])
def test_the_interval_over_few_seeds_and_episodes_covers_all_resamples(statistic):
    """Every choice of 3 of 3 seeds with every one of 4 of 4 episodes, by hand."""
    samples = np.random.default_rng(5).exponential(size=(3, 4, 2)) + 1.0
    samples = samples if statistic else samples[..., 0]
    every = []
    for rows, columns in product(product(range(3), repeat=3), product(range(4), repeat=4)):
        drawn = samples[np.ix_(rows, columns)].mean(axis=0)
        means = drawn.mean(axis=0)
        every.append(means[0] / means[1] - 1.0 if statistic else means)
    expected = np.percentile(every, [2.5, 97.5])
    given = {"statistic": statistic} if statistic else {}
    np.testing.assert_allclose(seeds_ci95(samples, **given), expected, atol=0.04 * np.ptp(expected))


def test_the_interval_of_one_seed_is_that_of_its_episodes():
    samples = np.random.default_rng(6).normal(size=50)
    assert seeds_ci95(samples[None], 7) == bootstrap_ci95(samples, 7)


@pytest.mark.parametrize("size", [1, 3, 4, 7, 8])
def test_interquartile_mean_is_scipys_trimmed_mean(size):
    samples = np.random.default_rng(size).exponential(size=(5, size))
    expected = stats.trim_mean(samples, 0.25, axis=1)
    np.testing.assert_allclose(interquartile_mean(samples), expected, rtol=1e-12)
