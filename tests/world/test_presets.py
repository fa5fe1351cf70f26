"""Presets: their lists in --help, and numbers that must go together."""

import numpy as np
import pytest

from medjax import trajectories
from medjax.render import __main__ as render
from medjax.scenarios import prepare
from medjax.world.presets import SCENARIOS
from tests.train.conftest import exit_code
from train import evaluate, ppo


@pytest.mark.parametrize("command", [ppo, evaluate, render, trajectories])
def test_help_lists_them(capsys, command):
    """As `print(medjax.SCENARIOS)` does."""
    assert exit_code(command, ["--help"]) == 0
    shown = capsys.readouterr().out.partition("presets:\n")[2]
    assert [line.split()[0] for line in str(SCENARIOS).splitlines()] == list(SCENARIOS)
    for line in str(SCENARIOS).splitlines():
        assert " ".join(line.split()) in " ".join(shown.split())
        assert f"\n  {line[:20]}" in f"\n{shown}"


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_patience_suffices_to_reach_the_slot(name):
    """From the farthest MED at the approach speed, plus 10 s."""
    charging = SCENARIOS[name].params(SCENARIOS[name].config).charging
    longest_s = float(charging.reach_ahead_m / charging.approach_speed)
    assert float(charging.patience_s) >= longest_s + 10.0


def test_default_places_and_times_fit_the_road_and_the_episode_that_are_given():
    """Nobody is told of a number that they did not give."""
    _, params, _ = prepare("paper", length_m=2500, ramp_x_m=[100, 1200], num_exits=2)
    np.testing.assert_allclose(params.road.exit_x_m, [2500 / 3, 5000 / 3])
    short = {"ramp_x_m": [3300], "exit_x_m": [2700], "num_incidents": 1}
    _, params, _ = prepare("corridor", **{"road.length_m": 15000}, **short)
    incidents = params.incidents
    ends = [*incidents.incident_from_x_m, *incidents.incident_until_x_m]
    np.testing.assert_allclose(ends, [3750, 11250])
    for decisions, times in ((600, (120, 300)), (200, (120, 200)), (100, (100, 100))):
        _, params, _ = prepare("paper", num_incidents=1, episode_decisions=decisions)
        incidents = params.incidents
        ends = [*incidents.incident_from_s, *incidents.incident_until_s]
        np.testing.assert_allclose(ends, times)
