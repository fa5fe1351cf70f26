"""The command that tunes the rules reports every setting, and the best of each rule."""

import json

import pytest

from benchmarks.studies import tune
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.slow
def test_best_is_the_highest_return(tmp_path, monkeypatch, capsys):
    """One line a setting; rules that send MEDs beat the same ones told to send hardly any."""
    grid = {
        "paced": [{"ramp": 1, "interval_s": 30}, {"ramp": 1, "interval_s": 10_000}],
        "forecast": [{"window_s": 60, "enough": 1000.0}, {"window_s": 60, "enough": 4.0}],
    }
    monkeypatch.setattr(tune, "GRID", grid)
    out = tmp_path / "out.json"
    tune.main(["--episodes=4", "--rules", "paced", "forecast", f"--json={out}"])
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert report["paced"]["best"] == report["paced"]["rows"][0]
    assert report["forecast"]["best"] == report["forecast"]["rows"][1]
    assert "best paced: ramp 1, interval_s 30" in printed
    assert "best forecast: window_s 60, enough 4" in printed
    for row in (*report["paced"]["rows"], *report["forecast"]["rows"]):
        assert f"{row['return_mean']:.1f}" in printed
        assert row["return_ci95"][0] <= row["return_mean"] <= row["return_ci95"][1]


@pytest.mark.slow
def test_climbs_to_a_surely_better_rule(tmp_path, capsys):
    """From the numbers of `forecast`, on episodes of its own, in a few rounds."""
    out = tmp_path / "out.json"
    tune.main(["--rules=budgeted", "--rounds=6", "--episodes=256", f"--json={out}"])
    found = json.loads(out.read_text())["budgeted"]
    assert len(found["rounds"]) == 6
    assert 0.0 < found["gain_ci95"][0] < found["gain_mean"] < found["gain_ci95"][1]
    printed = capsys.readouterr().out
    assert "budgeted: round  6" in printed
    assert "ramp 4 " in printed
    assert f"gains on forecast {found['gain_mean']:.1f}" in printed


@pytest.mark.parametrize(
    "argv",
    [
        ["--episodes=1"],
        ["--rounds=0"],
        ["--groups=no"],
        ["--groups=7"],
        ["--rules=best"],
        ["--scenario=nowhere"],
        ["--set=size=99"],
    ],
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(tune.main, argv, capsys)
