"""The command that writes trajectories: what it plays, and what it refuses."""

import itertools
import sys

import chex
import jax
import numpy as np
import pytest

from medjax.trajectories import main

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_the_command_plays_the_episode_that_it_is_asked_for(played, recording):
    """In pieces what it is in one, bit for bit: frames, decisions, times, and who is where."""
    pieces, target = played
    for piece in pieces:
        assert (piece.policy, piece.scenario) == ("paced", "paper")
        assert (piece.seed, piece.episode) == (3, 1)
        assert piece.config == recording.config
    assert [len(piece.decisions.action) for piece in pieces] == [23, 23, 23, 21]
    for piece, after in itertools.pairwise(pieces):
        last, first = (tree_at(each.frames, at) for each, at in ((piece, -1), (after, 0)))
        chex.assert_trees_all_equal(last, first)
    fresh = [(piece, piece.first_frame > 0) for piece in pieces]
    frames = [jax.tree.map(lambda leaf, n=n: leaf[n:], piece.frames) for piece, n in fresh]
    chex.assert_trees_all_equal(jax.tree.map(joined, *frames), recording.frames)
    decisions = [piece.decisions for piece in pieces]
    chex.assert_trees_all_equal(jax.tree.map(joined, *decisions), recording.decisions)
    times, ids = ([each(piece)[n:] for piece, n in fresh] for each in (times_of, ids_of))
    np.testing.assert_array_equal(joined(*times), recording.time_s)
    np.testing.assert_array_equal(joined(*ids), recording.vehicle_ids())
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def tree_at(tree, at):
    return jax.tree.map(lambda leaf: leaf[at], tree)


def joined(*leaves):
    return np.concatenate(leaves)


def times_of(piece):
    return piece.time_s


def ids_of(piece):
    return piece.vehicle_ids()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--policy", "best"], "unknown policy 'best': allowed none, slow, random"),
        (["--scenario", "papr"], "unknown scenario 'papr': allowed paper, realistic"),
        (["--out", "run.txt"], "run.txt: allowed endings .parquet, .csv, .fcd.xml"),
        (
            ["--out", "nowhere/run.csv"],
            "trajectories nowhere/run.csv: No such file or directory; allowed",
        ),
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
