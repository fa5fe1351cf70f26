"""What the player says in words."""

import dataclasses
import json
import os

import jax
import numpy as np
import pytest

from benchmarks.studies.leaderboard import BOARD, known_of, read_board
from medjax.env.reward import MONEY, Outcome
from medjax.episodes.verdict import LINES, NAMES
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from medjax.render.story import (
    BEFORE_S,
    KNOWN,
    ending,
    first_charge_s,
    known_evaluation,
    means,
    read_evaluation,
    verdict,
    words_for,
)
from medjax.world.params import PRICES
from tests.render.made import evaluated
from train.evaluation.summary import summarize


def test_every_rule_has_a_sentence_and_nobody_else_gets_one_made_up():
    for name in BASELINES:
        words = words_for(name)
        assert words.endswith(".")
        assert "`" not in words
        assert "_" not in words  # a reader knows no functions
    assert "PPO" in words_for("pretrained")
    assert "PPO" in words_for("ppo") == words_for("ppo_seed2")
    assert words_for("mine") == ""


def test_it_opens_before_the_first_charge(still):
    charging = np.zeros_like(np.asarray(still.frames.ev_is_charging))
    frames = still.frames
    assert first_charge_s([dataclasses.replace(still, frames=_with(frames, charging))]) == 0.0
    charging[-1, 0] = True
    late = dataclasses.replace(still, frames=_with(frames, charging))
    expected = max(0.0, (len(charging) - 1) * still.config.tick_s - BEFORE_S)
    assert first_charge_s([late]) == expected


def _with(frames, charging):
    return frames.replace(ev_is_charging=charging)


def test_verdict_is_of_the_whole_episode(recording, other):
    rows = {row["title"]: row["values"] for row in verdict([recording, other])}
    assert rows["MEDs sent"][0] == (np.asarray(recording.decisions.sent) > 0).sum()
    assert rows["return"][0] == np.sum(recording.decisions.reward, dtype=np.float64)
    assert rows["kWh received"][0] > 0.0


def test_cost_is_what_the_terms_of_money_say(recording):
    """Sums over the episode, weighed with the prices of the preset."""
    step_stats = jax.tree.map(lambda each: np.sum(each, axis=0), recording.decisions.tally)
    outcome = Outcome(before=None, after=None, step_stats=step_stats, params=None, config=None)
    paid = -sum(PRICES[name].default * float(term(outcome)) for name, term in MONEY.items())
    rows = {row["title"]: row["values"] for row in verdict([recording])}
    assert rows["cost, EUR"][0] == pytest.approx(paid, rel=1e-5)
    assert paid > 0.0


def test_the_ending_says_what_many_episodes_say(recording, other):
    entry = {**dict.fromkeys(NAMES, 2.0), "return_ci95": [0.0, 1.0]}
    crosses = int(np.sum(recording.decisions.tally.depleted))
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
    """The board is played anew where the world changes: what is shown beside an episode may not be older."""
    known = known_evaluation("paper", ["pretrained", "forecast"])
    assert known == known_of(read_board(BOARD))


def test_means_stand_with_the_intervals_that_there_are(recording):
    """Of the return there always is one; a mean is within its own."""
    many = evaluated(recording)
    entry = many["policies"][recording.policy]
    (bare,) = means(many, [recording])
    assert [("[" in cell) for cell in bare] == [line.title == "return" for line in LINES]
    entry["verdict_ci95"] = {"ran out": [1.04, 3.0]}
    (cells,) = means(many, [recording])
    assert cells[0] == f"{bare[0]} [1.0, 3.0]"
    assert cells[1:] == bare[1:]


def test_an_evaluation_of_ones_own_has_all_intervals(recording, tmp_path):
    """As `train.evaluate --json` writes it."""
    rng = np.random.default_rng(0)
    scores = {name: rng.uniform(1.0, 2.0, 9) for name in (*NAMES, "return")}
    many = summarize({recording.policy: scores}, recording.scenario, [])
    path = tmp_path / "many.json"
    path.write_text(json.dumps(many))
    (cells,) = means(read_evaluation(path), [recording])
    for cell in cells:
        mean, low, high = (float(number.strip("[,]")) for number in cell.split())
        assert low <= mean <= high


def test_the_boards_intervals_hold_its_means():
    known = known_evaluation("paper", ["pretrained", "forecast"])
    for entry in known["policies"].values():
        for line in LINES[:-1]:
            low, high = entry["verdict_ci95"][line.title]
            assert low <= line.of(entry) <= high


def test_what_is_not_known_is_not_shown():
    assert [path.name for path in KNOWN.iterdir()] == ["paper.json"]
    assert known_evaluation("corridor", ["forecast"]) is None
    assert known_evaluation("paper", ["forecast", "mine"]) is None


def test_an_evaluation_of_something_else_is_refused(recording, tmp_path):
    path = tmp_path / "evaluation.json"
    broken = evaluated(recording)
    broken["policies"][recording.policy]["verdict_ci95"] = {"ran out": [1.0]}
    for text in (
        "",
        json.dumps(broken),
        "{}",
        "[1]",
        "[" * 200_000,
        json.dumps({"policies": {"a": {}}, "episodes": 1}),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match="--evaluation"):
            read_evaluation(path)
    os.mkfifo(tmp_path / "pipe")  # which nobody writes to
    with pytest.raises(InputError, match="no file"):
        read_evaluation(tmp_path / "pipe")
    path.write_text(json.dumps(evaluated(recording)))
    found = read_evaluation(path)
    with pytest.raises(InputError, match="moon"):
        means({**found, "scenario": "moon"}, [recording])
    with pytest.raises(InputError, match="other"):
        means({**found, "policies": {"other": {}}}, [recording])
