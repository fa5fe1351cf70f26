"""The report's conclusion on made numbers, and its words for policies."""

from types import SimpleNamespace

import numpy as np
import pytest

from medjax.policies.rules import BASELINES
from train.evaluation.tables import SAMPLED, START
from train.reporting.report import Played, conclude
from train.reporting.words import TERMS, policies_in_words

NAMES = ["ppo", "none", "slow", "forecast", "budgeted"]
RETURNS = {"ppo": 5.0, "none": -9.0, "slow": 9.0, "forecast": 1.0, "budgeted": 2.0}
ARRIVED = np.array([60, 10, 30, 50, 45])  # EVs, by name; the others of 100 ran out
LOST_H = {"ppo": 0.75, "none": 0.5, "slow": 0.6, "forecast": 0.7, "budgeted": 0.8}
EPISODES = 10


@pytest.fixture
def played():
    scores = {
        name: {
            "gas_delay_h": np.full(EPISODES, LOST_H[name]),
            "depleted_share": np.full(EPISODES, 1.0 - arrived / 100.0),
        }
        for name, arrived in zip(NAMES, ARRIVED, strict=True)
    }
    bins = np.stack([ARRIVED // 2, ARRIVED - ARRIVED // 2], axis=1)
    return Played(
        env=SimpleNamespace(config=SimpleNamespace(decision_s=1.0)),
        params=SimpleNamespace(episode_decisions=600),
        seed=0,
        scores=scores,
        result={"policies": {name: {"return_mean": value} for name, value in RETURNS.items()}},
        names=NAMES,
        seen=SimpleNamespace(exit_soc=bins, depleted=100 - ARRIVED, stops=np.zeros(len(NAMES))),
        first=None,
    )


def config(seeds=1):
    return SimpleNamespace(algorithm="ppo", num_seeds=seeds)


def test_the_conclusion_counts_evs_and_minutes_under_four_policies(played):
    """The best rule is one that sends MEDs, though `slow` returns more here."""
    reach, lose = conclude(config(), played)
    assert reach.startswith(
        "Of 100 electric vehicles (EVs), 60 reach their exit with the trained policy (ppo), 45 with the best rule "
        "(budgeted), 30 if EVs low on charge drive slowly, without any charging truck (slow), and 10 if nothing is "
        "done (none)."
    )
    assert "EVs of 100 that run out: lower with ppo than with budgeted" in reach
    assert "-15.00 [-15.00, -15.00]" in reach
    minutes = (
        "45 min with the trained",
        "48 min with the best",
        "36 min if EVs",
        "30 min if nothing",
    )
    assert all(each in lose for each in minutes)
    assert "In an episode of 10 min" in lose
    assert "higher with ppo than with none in the same 10 episodes, +15.00" in lose


def test_evs_that_leave_to_charge_do_not_reach_their_exit(played):
    """Of the 60 and 10 that leave the road, 15 and 9 break off their trip; the other policies are told as before."""
    played.seen.stops = np.array([15, 9, 0, 0, 0])
    reach, _ = conclude(config(), played)
    assert reach.startswith(
        "Of 100 electric vehicles (EVs), 45 reach their exit and 15 leave to charge with the trained policy (ppo), "
        "45 reach their exit with the best rule (budgeted), 30 reach their exit if EVs low on charge"
    )
    assert "and 1 reach their exit and 9 leave to charge if nothing is done (none)." in reach


def test_of_several_seeds_the_conclusion_is_of_the_first(played):
    assert "the trained policy (ppo, the first of 3 seeds)" in conclude(config(3), played)[0]


def test_terms_and_policies_have_words_of_their_own():
    words = policies_in_words(
        ["ppo", "ppo" + SAMPLED, "ppo_seed2", START, START + SAMPLED, *BASELINES]
    )
    assert all(said.endswith(".") for said in [*words.values(), *TERMS.values()])
    told_apart = [words[name] for name in ("budgeted", "slow", "none", "ppo", START)]
    assert len(set(told_apart)) == len(told_apart)
    assert {"return", "depleted", "MED", "baseline"} <= TERMS.keys()
