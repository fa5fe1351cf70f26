"""The player's texts and tables."""

import dataclasses
import json
import os
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import medjax
from benchmarks.studies.leaderboard import BOARD, known_of, read_board
from medjax.env.reward import MONEY, Outcome
from medjax.episodes.verdict import COUNTED, LINES, NAMES
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from medjax.render.story import (
    BEFORE_S,
    KNOWN,
    check_evaluation,
    ending,
    first_charge_s,
    known_evaluation,
    means,
    read_evaluation,
    verdict,
    words_for,
)
from medjax.world.weights import PRICES
from tests.render.made import evaluated
from train.evaluation.summary import summarize


def test_policies_have_a_sentence_and_unknown_ones_none():
    for name in BASELINES:
        words = words_for(name)
        assert words.endswith(".")
        assert not set("`_") & set(words)  # names of functions
    assert "PPO" in words_for("pretrained")
    assert "draws each action" in words_for("pretrained_sampled")
    assert "PPO" in words_for("ppo") == words_for("ppo_seed2")
    assert words_for("mine") == ""


def test_the_player_opens_before_the_first_charge(recording):
    charging = np.zeros_like(np.asarray(recording.frames.ev_is_charging))
    frames = recording.frames.replace(ev_is_charging=charging)
    charged = dataclasses.replace(recording, frames=frames)
    assert first_charge_s([charged]) == 0.0
    charging[100, 0] = True
    assert first_charge_s([charged]) == 100 * recording.config.tick_s - BEFORE_S > 0.0
    charging[4, 0] = True  # earlier than the player opens before a charge
    assert first_charge_s([charged]) == 0.0 > 4 * recording.config.tick_s - BEFORE_S


def test_verdict_covers_the_whole_episode(recording, other):
    """Its cost weighs the sums of the terms of money with the preset's prices."""
    rows = {row["title"]: row["values"] for row in verdict([recording, other])}
    assert rows["MEDs sent"][0] == (np.asarray(recording.decisions.sent) > 0).sum()
    assert rows["return"][0] == np.sum(recording.decisions.reward, dtype=np.float64)
    assert rows["kWh received"][0] > 0.0
    step_stats = jax.tree.map(lambda each: np.sum(each, axis=0), recording.decisions.stats)
    env, params = medjax.make("paper")
    before = SimpleNamespace(time=0)
    outcome = Outcome(before, None, step_stats, params, env.config)
    paid = -sum(PRICES[name].default * float(term(outcome)) for name, term in MONEY.items())
    assert rows["cost, EUR"][0] == pytest.approx(paid, rel=1e-5)
    assert paid > 0.0


def cost_of(rows):
    return next(row["values"][0] for row in rows if row["title"] == "cost, EUR")


def test_the_cost_of_a_world_in_money_is_what_its_reward_counts(freight):
    """With prices by the hour, plugs and wear, which default prices do not know."""
    terms = {name: np.sum(part) for name, part in freight.decisions.reward_terms.items()}
    rows = verdict([freight])
    cost = cost_of(rows)
    assert cost == pytest.approx(-sum(terms.values()), rel=1e-5)
    assert cost == pytest.approx(-np.sum(freight.decisions.reward, dtype=np.float64), rel=1e-5)
    assert min(-terms[name] for name in ("plug_h", "med_wear_kwh", "ev_kwh", "med_h")) > 0.0
    stats, factors = freight.decisions.stats, freight.params.market.hourly_price
    drawn_kwh = (stats.med_driving_j + stats.energy_sent_j) / 3.6e6
    hours = (13.9 + np.arange(60) * freight.config.decision_s / 3600.0).astype(int)
    assert {*hours} == {13, 14}
    assert terms["depot_kwh"] == pytest.approx(-0.22 * drawn_kwh @ factors[hours], rel=1e-5)
    parts = {name: np.zeros(60) for name in ("soc", "distance")}  # not in money
    paper = dataclasses.replace(freight, decisions=freight.decisions.replace(reward_terms=parts))
    assert abs(cost_of(verdict([paper])) - cost) > 10.0


def test_mean_costs_of_a_world_in_money_are_those_of_its_reward(freight):
    """The mean and both ends of its interval."""
    rng = np.random.default_rng(0)
    scores = {name: rng.uniform(1.0, 2.0, 9) for name in NAMES}
    terms = {name: -rng.uniform(1e3, 2e3, 9) for name in COUNTED}
    scores |= {**terms, "return": sum(terms.values())}
    many = summarize({freight.policy: scores}, freight.scenario, [])
    (cells,) = means(many, [freight])
    at = [line.title for line in LINES].index("cost, EUR")
    mean, low, high = (float(number.strip("[,]")) for number in cells[at].split())
    assert mean == pytest.approx(-np.mean(scores["return"]), abs=0.5)
    assert 1e4 < low < mean < high < 2e4


def test_the_ending_compares_with_the_mean_of_many_episodes(recording, other):
    entry = {**dict.fromkeys(NAMES, 2.0), "return_ci95": [0.0, 1.0]}
    crosses = int(np.sum(recording.decisions.stats.depleted))
    assert ending([recording], None) == (
        f"{crosses} EVs run out in this episode (one is luck as much as skill)"
    )
    many = {"episodes": 7, "policies": {"periodic": entry, "none": {**entry, "evs_depleted": 3.04}}}
    assert ending([recording, other], many) == (
        f"{crosses} EVs run out with periodic, {crosses} with none in this episode; 2.0 and 3.0 in the mean of 7"
    )
    del many["policies"]["none"]
    assert "luck" in ending([recording, other], many)


def test_known_means_are_those_of_the_leaderboard():
    """With its intervals; policies and presets that it lacks have none."""
    known = known_evaluation("paper", ["pretrained", "forecast"])
    assert known == known_of(read_board(BOARD))
    for entry in known["policies"].values():
        for line in LINES[:-1]:
            low, high = entry["verdict_ci95"][line.title]
            assert low <= line.of(entry) <= high
    assert [path.name for path in KNOWN.iterdir()] == ["paper.json"]
    assert known_evaluation("corridor", ["forecast"]) is None
    assert known_evaluation("paper", ["forecast", "mine"]) is None


def test_means_show_known_intervals(recording):
    """That of the return is always known."""
    many = evaluated(recording)
    entry = many["policies"][recording.policy]
    (bare,) = means(many, [recording])
    assert [("[" in cell) for cell in bare] == [line.title == "return" for line in LINES]
    entry["verdict_ci95"] = {"ran out": [1.04, 3.0]}
    (cells,) = means(many, [recording])
    assert cells[0] == f"{bare[0]} [1.0, 3.0]"
    assert cells[1:] == bare[1:]


def test_evaluations_of_the_command_have_all_intervals(recording, tmp_path):
    rng = np.random.default_rng(0)
    scores = {name: rng.uniform(1.0, 2.0, 9) for name in (*NAMES, "return")}
    many = summarize({recording.policy: scores}, recording.scenario, [])
    path = tmp_path / "many.json"
    path.write_text(json.dumps(many))
    (cells,) = means(read_evaluation(path), [recording])
    for cell in cells:
        mean, low, high = (float(number.strip("[,]")) for number in cell.split())
        assert low <= mean <= high


def test_bad_evaluations_are_refused(recording, tmp_path):
    path = tmp_path / "evaluation.json"
    broken = evaluated(recording)
    broken["policies"][recording.policy]["verdict_ci95"] = {"ran out": [1.0]}
    unpriced = evaluated(recording)
    unpriced["policies"][recording.policy]["reward_tows"] = None
    empty = json.dumps({"policies": {"a": {}}, "episodes": 1})
    odd = [json.dumps(evaluated(recording) | more) for more in ({"reward": 5}, {"overrides": [1]})]
    texts = "", json.dumps(broken), json.dumps(unpriced), "{}", "[1]", "[" * 200_000, empty, *odd
    for text in texts:
        path.write_text(text)
        with pytest.raises(InputError, match="--evaluation"):
            read_evaluation(path)
    os.mkfifo(tmp_path / "pipe")  # without a writer
    with pytest.raises(InputError, match="is not a file"):
        read_evaluation(tmp_path / "pipe")
    path.write_text(json.dumps(evaluated(recording)))
    found = read_evaluation(path)
    with pytest.raises(InputError, match="moon"):
        means({**found, "scenario": "moon"}, [recording])
    with pytest.raises(InputError, match="other"):
        means({**found, "policies": {"other": {}}}, [recording])


def test_an_evaluation_of_another_world_is_refused(recording):
    found = {**evaluated(recording), "overrides": {"cooldown_s": 30}}
    own = recording.scenario, [recording.policy]
    check_evaluation(found, *own, {"cooldown_s": 30.0})
    with pytest.raises(InputError, match=r'{"cooldown_s": 30}: allowed {}'):
        check_evaluation(found, *own, {})
    with pytest.raises(InputError, match="served, dispatches: allowed that of paper"):
        check_evaluation(found | {"reward": ["served", "dispatches"]}, *own, found["overrides"])
