"""The command that tunes the paced rule reports every pair, and the best."""

import json

import pytest

from benchmarks import tune
from tests.benchmarks.refusal import refused


def test_best_is_the_highest_return(tmp_path, monkeypatch, capsys):
    """One line a pair; with paces of 30 s and one that sends a single MED, the first is better."""
    monkeypatch.setattr(tune, "INTERVALS_S", (30, 10_000))
    out = tmp_path / "out.json"
    tune.main(["--episodes=4", "--ramps=1", f"--json={out}"])
    report = json.loads(out.read_text())
    assert [row["interval_s"] for row in report["rows"]] == [30, 10_000]
    assert report["best"] == report["rows"][0]
    printed = capsys.readouterr().out
    assert "best: ramp 1, every 30 s" in printed
    for row in report["rows"]:
        assert f"{row['return_mean']:.1f}" in printed
        assert row["return_ci95"][0] <= row["return_mean"] <= row["return_ci95"][1]


@pytest.mark.parametrize("argv", [["--episodes=1"], ["--ramps=0"], ["--scenario=nowhere"]])
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(tune.main, argv, capsys)
