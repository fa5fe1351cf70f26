"""What the player says in words."""

import dataclasses

import numpy as np

from medjax.policies.rules import BASELINES
from medjax.render.story import BEFORE_S, first_charge_s, verdict, words_for


def test_every_rule_has_a_sentence_and_nobody_else_gets_one_made_up():
    for name in BASELINES:
        words = words_for(name)
        assert words.endswith(".")
        assert "`" not in words
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
