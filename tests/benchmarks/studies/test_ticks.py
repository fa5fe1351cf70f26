"""The command that compares ticks plays what it says, and refuses what no decision consists of."""

import json

import numpy as np
import pytest

import medjax
from benchmarks.studies import ticks
from medjax.episodes.scores import evaluate_policies
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.slow
def test_rows_are_the_episodes_at_each_tick(tmp_path, monkeypatch, capsys):
    """Beside an environment made by hand; the first tick is what the others are compared with."""
    monkeypatch.setattr(ticks, "RULES", ("none",))
    out = tmp_path / "out.json"
    ticks.main(["--episodes=2", "--ticks", "0.25", "0.5", f"--json={out}"])
    fine, coarse = json.loads(out.read_text())["rows"]
    returns = {}
    for row, number in ((coarse, 2), (fine, 4)):
        env, params = medjax.make("paper", tick_s=1.0 / number, ticks_per_round=number)
        policies = {"none": medjax.BASELINES["none"](env)}
        returns[number] = evaluate_policies(env, params, policies, 2, 0)["none"]["return"]
        assert row["return"] == pytest.approx(returns[number].mean())
    assert coarse["return_change"] == pytest.approx(np.mean(returns[2] - returns[4]))
    assert fine["return_change"] == 0.0
    assert "none" in capsys.readouterr().out


@pytest.mark.parametrize("argv", [["--ticks=0.3"], ["--ticks=0"], ["--scenario=nowhere"]])
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(ticks.main, argv, capsys)
