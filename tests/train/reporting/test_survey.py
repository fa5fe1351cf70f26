"""Sums over episodes, by hand and from samples."""

import jax
import numpy as np
import pytest

import medjax
from medjax.episodes.scores import evaluate_policies
from train.reporting.diagrams import plot_episode
from train.reporting.survey import SOC_BINS, dispatch_rows, quantile, survey, total
from train.reporting.traces import Frame, Trace, record


def trace_by_hand():
    """One policy, two EV slots, three decisions: one leaves half charged to charge, one runs out, one enters."""
    on_road = np.array([[1, 1], [0, 1], [1, 0], [1, 0]], bool)
    soc = np.array([[0.6, 0.1], [0.505, 0.05], [0.7, 0.0], [0.6, 0.0]])
    meds = np.zeros((4, 1)), np.zeros((4, 1), bool), np.zeros((4, 1), int)
    frames = Frame(np.zeros((4, 2)), soc, on_road, *meds)
    need = np.array([[1.0, 3.0], [2.0, 0.5], [1.0, 1.0]])
    counts = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])  # ran out, left to charge
    trace = Trace(frames, np.array([2, 0, 1]), need, np.zeros(3), *counts)
    return jax.tree.map(lambda leaf: leaf[None, None], trace)


def test_a_survey_by_hand():
    seen = survey(trace_by_hand())
    assert seen.depleted.tolist() == [1.0]
    assert seen.stops.tolist() == [1.0]
    assert np.flatnonzero(seen.exit_soc[0]).tolist() == [50]
    assert seen.soc.sum(axis=-1).tolist() == [[2, 1, 1, 1]]
    assert seen.sent[0].tolist() == [[0, 1], [0, 0], [1, 0]]
    assert seen.need_there.tolist() == [3.0 + 1.0]
    assert seen.to_greatest.tolist() == [2]
    twice = total([seen, seen])
    assert twice.episodes == 2
    assert twice.stops.tolist() == [2.0]
    assert dispatch_rows(["a"], twice)[1] == [
        "a", "2.00", "1.00", "1.00", "100%", "2.000", "1.417",
    ]  # fmt: skip


@pytest.mark.thorough
def test_every_ev_is_traced_if_a_decision_has_several_rounds(quick_compiles, tmp_path):
    """As many EVs leave as entered and are gone at the end, and each is drawn where it drove."""
    rounds = 4
    few = {"num_meds": 3, "num_evs": 6, "num_gas": 12, "episode_decisions": 40, "ev_share": 0.9}
    few |= {"rounds_per_decision": rounds}
    env, params = medjax.make("paper", **few)
    policies = {"random": medjax.BASELINES["random"](env)}
    (trace,) = record(env, params, policies, 2, seed=0)
    score = evaluate_policies(env, params, policies, 2, seed=0)["random"]
    on_road = trace.frames.ev_on_road
    assert on_road.shape[2] == 1 + 40 * rounds

    def left_a_slot(there):
        return (there[:, :, :-1] & ~there[:, :, 1:]).sum()

    ended = score["evs_entered"].sum() - on_road[:, :, -1].sum()
    assert left_a_slot(on_road) == ended > left_a_slot(on_road[:, :, ::rounds])
    still_there = (on_road & (trace.frames.ev_soc <= 0.0))[:, :, -1].sum()
    ran_out = score["evs_depleted"].sum() - still_there
    assert ended > ran_out > 0
    seen = survey(trace, rounds)
    assert seen.exit_soc[0].sum() == ended - ran_out
    assert seen.soc.sum(axis=-1).tolist() == [on_road[:, 0, ::rounds].sum(axis=(0, 2)).tolist()]
    moved = np.diff(trace.frames.ev_x, axis=2)[on_road[:, :, :-1]]
    assert (moved >= 0.0).all()
    assert moved.max() < 50.0
    first = jax.tree.map(lambda leaf: leaf[0, 0], trace)
    every_s = env.config.round_s, env.config.decision_s
    marked = plot_episode(tmp_path / "episode.png", first, params.road, every_s, "one")
    assert marked["depleted"] == score["evs_depleted"][0]


@pytest.mark.parametrize("share", [0.05, 0.25, 0.5, 0.95])
def test_quantiles_of_a_histogram_are_those_of_the_samples(share):
    samples = np.random.default_rng(0).beta(2.0, 5.0, (3, 5000))
    counts = np.stack([np.histogram(row, SOC_BINS, (0.0, 1.0))[0] for row in samples])
    got = quantile(counts, share)
    np.testing.assert_allclose(got, np.quantile(samples, share, axis=1), atol=1.0 / SOC_BINS)
    assert np.isnan(quantile(np.zeros((2, SOC_BINS), int), share)).all()
