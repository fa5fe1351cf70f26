"""The estimate of playing time."""

from types import SimpleNamespace

import jax
import pytest

import medjax
from medjax.episodes.duration import reckoned_time
from medjax.wrappers.decide_every import DecideEvery

ENV = SimpleNamespace(config=SimpleNamespace(num_vehicles=200, ticks_per_decision=4))


@pytest.mark.parametrize(
    ("decisions", "words"),
    [(1e5, ""), (1e6, "40 s to 3 min"), (1e7, "7 min to 27 min"), (1e9, "11.1 h to 44.4 h")],
)
def test_time_is_proportional_to_slots_and_ticks(decisions, words, monkeypatch):
    """800 slots times ticks per decision, each 50 to 200 ns: 1e6 decisions take 40 to 160 s."""
    monkeypatch.setattr(jax, "device_count", lambda: 1)
    assert reckoned_time(ENV, decisions) == words


def test_devices_share_the_time_and_gpus_have_no_estimate(monkeypatch):
    monkeypatch.setattr(jax, "device_count", lambda: 2)
    assert reckoned_time(ENV, 1e6) == "20 s to 80 s"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert reckoned_time(ENV, 1e6) == ""


def test_wrappers_have_their_environments_estimate():
    env, _ = medjax.make("paper")
    said = reckoned_time(env, 1e8)
    assert said.endswith("h")
    assert reckoned_time(DecideEvery(env, 4), 1e8) == said
    assert reckoned_time(SimpleNamespace(config=None), 1e8) == ""
