"""The command that writes trajectories: what it plays, and what it refuses."""

import sys

import pytest

from medjax.trajectories import main
from tests.episodes.conftest import WORLD

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_the_command_plays_the_episode_that_it_is_asked_for(played):
    recording, target = played
    assert (recording.policy, recording.scenario) == ("paced", "paper")
    assert (recording.seed, recording.episode) == (3, 1)
    assert {name: getattr(recording.config, name) for name in list(WORLD)[:3]} == {
        name: WORLD[name] for name in list(WORLD)[:3]
    }
    assert len(recording.decisions.action) == WORLD["episode_decisions"]
    assert [path.name for path in target.parent.iterdir()] == [target.name]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--policy", "best"], "unknown policy 'best': allowed none, slow, random"),
        (["--scenario", "papr"], "unknown scenario 'papr': allowed paper, realistic"),
        (["--out", "run.txt"], "run.txt: allowed endings .parquet, .csv, .fcd.xml"),
        (["--out", "nowhere/run.csv"], "no directory nowhere"),
        (["--seed", "-1"], "--seed '-1': allowed a whole number from 0 to 4294967295"),
        (["--set", "cooldown_s"], "--set cooldown_s: allowed NAME=VALUE"),
        (["--set", "cooldwn_s=1"], "unknown option 'cooldwn_s': did you mean"),
        (["--set", "cooldown_s=-1"], "cooldown_s = -1: allowed a number from 0 to 1e+06"),
        (["--pollicy", "none"], "unrecognized arguments: --pollicy none"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(change, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["--out", "run.csv", *change])
    assert end.value.code == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_parquet_without_pyarrow_names_the_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SystemExit) as end:
        main(["--out", str(tmp_path / "run.parquet")])
    assert end.value.code == 2
    assert 'pip install -e ".[trajectories]"' in capsys.readouterr().err
