"""Presets: numbers of one that must go together."""

import pytest

from medjax import trajectories
from medjax.render import __main__ as render
from medjax.world.presets import SCENARIOS
from tests.train.conftest import exit_code
from train import evaluate, ppo


@pytest.mark.parametrize("command", [ppo, evaluate, render, trajectories])
def test_help_lists_them(capsys, command):
    """Each with what it is, as `print(medjax.SCENARIOS)` does, on lines that begin with their names."""
    assert exit_code(command, ["--help"]) == 0
    shown = capsys.readouterr().out.partition("presets:\n")[2]
    assert [line.split()[0] for line in str(SCENARIOS).splitlines()] == list(SCENARIOS)
    for line in str(SCENARIOS).splitlines():
        assert " ".join(line.split()) in " ".join(shown.split())
        assert f"\n  {line[:20]}" in f"\n{shown}"


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_a_booking_lasts_for_the_way_to_its_slot(name):
    """From as far as a MED may be asked, closing up at the approach speed, and 10 s for the rest."""
    charging = SCENARIOS[name].params(SCENARIOS[name].config).charging
    longest_s = float(charging.reach_ahead_m / charging.approach_speed)
    assert float(charging.patience_s) >= longest_s + 10.0
