"""The command that writes trajectories: what it plays, and what it refuses."""

import itertools
import sys

import chex
import jax
import numpy as np
import pytest

from medjax.commandline import leave
from medjax.episodes.recording import Recording
from medjax.trajectories import main


def joined(*leaves):
    return np.concatenate(leaves)


def test_the_command_plays_the_requested_episode(played, recording):
    """Pieces, without their first frame, are the whole episode, bit for bit."""
    pieces, target = played
    for piece in pieces:
        assert (piece.policy, piece.scenario) == ("paced", "paper")
        assert (piece.seed, piece.episode) == (3, 1)
        assert piece.config == recording.config
    assert [len(piece.decisions.action) for piece in pieces] == [23, 23, 23, 21]
    for piece, after in itertools.pairwise(pieces):
        last = jax.tree.map(lambda leaf: leaf[-1], piece.frames)
        chex.assert_trees_all_equal(last, jax.tree.map(lambda leaf: leaf[0], after.frames))

    def whole(of):
        """Joins what `of` returns for each piece, without the frame that the piece before has."""
        new = [jax.tree.map(lambda leaf, n=p.first_frame > 0: leaf[n:], of(p)) for p in pieces]
        return jax.tree.map(joined, *new)

    chex.assert_trees_all_equal(whole(lambda piece: piece.frames), recording.frames)
    decisions = [piece.decisions for piece in pieces]
    chex.assert_trees_all_equal(jax.tree.map(joined, *decisions), recording.decisions)
    np.testing.assert_array_equal(whole(lambda piece: piece.time_s), recording.time_s)
    np.testing.assert_array_equal(whole(Recording.vehicle_ids), recording.vehicle_ids())
    assert [path.name for path in target.parent.iterdir()] == [target.name]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--policy", "best"], "unknown policy 'best': allowed none, slow, random"),
        (["--scenario", "papr"], "unknown scenario 'papr': allowed paper, realistic"),
        (["--out", "run.txt"], "run.txt: allowed endings .parquet, .csv, .fcd.xml"),
        (["--out", "no/run.csv"], "trajectories no/run.csv: No such file or directory; allowed"),
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


def test_a_policy_that_cannot_play_is_one_line(tmp_path, monkeypatch, capsys):
    """That is known only once it is asked for an action."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    module = "def build(env):\n    return lambda key, obs, state, params: obs\n"
    (tmp_path / "vector_player.py").write_text(module)
    with pytest.raises(SystemExit) as end:
        leave(main(["--policy", "vector_player:build", "--out", "run.csv"]))
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "allowed whole numbers, or a Choice" in said
    assert not (tmp_path / "run.csv").exists()


def test_parquet_without_pyarrow_names_the_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SystemExit) as end:
        main(["--out", str(tmp_path / "run.parquet")])
    assert end.value.code == 2
    assert 'pip install -e ".[trajectories]"' in capsys.readouterr().err
