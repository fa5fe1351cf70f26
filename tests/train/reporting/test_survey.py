"""Sums over episodes, by hand and from samples."""

import jax
import numpy as np
import pytest

from train.reporting.survey import SOC_BINS, dispatch_rows, quantile, survey, total
from train.reporting.traces import Frame, Trace


def trace_by_hand():
    """One policy, two EV slots, three decisions: an EV leaves with half its charge, one runs out, a third enters."""
    on_road = np.array([[1, 1], [0, 1], [1, 0], [1, 0]], bool)
    soc = np.array([[0.6, 0.1], [0.505, 0.05], [0.7, 0.0], [0.6, 0.0]])
    frames = Frame(
        ev_x=np.zeros((4, 2)),
        ev_soc=soc,
        ev_on_road=on_road,
        med_x=np.zeros((4, 1)),
        med_on_road=np.zeros((4, 1), bool),
        med_charges=np.zeros((4, 1), int),
    )
    need = np.array([[1.0, 3.0], [2.0, 0.5], [1.0, 1.0]])
    trace = Trace(frames, np.array([2, 0, 1]), need, np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return jax.tree.map(lambda leaf: leaf[None, None], trace)


def test_a_survey_by_hand():
    seen = survey(trace_by_hand())
    assert seen.depleted.tolist() == [1.0]
    assert np.flatnonzero(seen.exit_soc[0]).tolist() == [50]
    assert seen.soc.sum(axis=-1).tolist() == [[2, 1, 1, 1]]
    assert seen.sent[0].tolist() == [[0, 1], [0, 0], [1, 0]]
    assert seen.need_there.tolist() == [3.0 + 1.0]
    assert seen.to_greatest.tolist() == [2]
    twice = total([seen, seen])
    assert twice.episodes == 2
    assert dispatch_rows(["a"], twice)[1] == [
        "a", "2.00", "1.00", "1.00", "100%", "2.000", "1.417",
    ]  # fmt: skip


@pytest.mark.parametrize("share", [0.05, 0.25, 0.5, 0.95])
def test_quantiles_of_a_histogram_are_those_of_the_samples(share):
    samples = np.random.default_rng(0).beta(2.0, 5.0, (3, 5000))
    counts = np.stack([np.histogram(row, SOC_BINS, (0.0, 1.0))[0] for row in samples])
    got = quantile(counts, share)
    np.testing.assert_allclose(got, np.quantile(samples, share, axis=1), atol=1.0 / SOC_BINS)
    assert np.isnan(quantile(np.zeros((2, SOC_BINS), int), share)).all()
