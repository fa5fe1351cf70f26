"""Presets: their lists in --help, and numbers that must go together."""

import pytest

from medjax import trajectories
from medjax.render import __main__ as render
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
