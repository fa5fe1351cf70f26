"""The leaderboard: its table of known returns, its file, and bad input."""

import errno
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.studies import leaderboard
from benchmarks.studies.leaderboard import MEANS, known_of, main, read_board, rows_of, with_row
from medjax.render.story import read_evaluation
from tests.benchmarks.refusal import refused

METRICS = {**dict.fromkeys(MEANS, 1.0), "depleted_share": 0.25, "evs_depleted": 20.0}


def row(name, returns):
    return {
        "name": name,
        "policy": name,
        "about": "made",
        "means": METRICS,
        "verdict_ci95": {"ran out": [18.5, 21.5]},
        "returns": list(returns),
    }


def board(*rows):
    return {"scenario": "paper", "seed": 3, "episodes": 64, "rows": list(rows)}


NOISE = np.random.default_rng(0).normal(0.0, 50.0, 64)


@pytest.fixture
def path(tmp_path):
    """A file with a board of one row."""
    file = tmp_path / "board.json"
    leaderboard.write_board(file, board(row("none", NOISE)))
    return file


def test_the_best_is_first_and_differences_are_paired():
    """Noise of 50 that two policies share does not widen the interval of their difference."""
    head, first, second = rows_of(board(row("worse", NOISE - 7.0), row("better", NOISE)))
    below = head.index("below the first by, 95 % CI")
    assert (first[0], first[below]) == ("better", "")
    assert second[0] == "worse"
    assert second[below].replace(".000", "") == "7 [7, 7]"


def test_a_row_replaces_one_of_its_name(path):
    rows = board(row("a", NOISE), row("b", NOISE))
    leaderboard.write_board(path, with_row(rows, row("a", NOISE + 1.0)))
    again = read_board(path)
    assert [each["name"] for each in again["rows"]] == ["b", "a"]
    np.testing.assert_array_equal(again["rows"][1]["returns"], NOISE + 1.0)
    assert len(path.read_text().splitlines()) == 9  # a row a line
    leaderboard.write_board(path, board())
    assert read_board(path) == board()


def test_adding_plays_the_boards_episodes(path, monkeypatch, capsys):
    asked = {}
    scores = {"mine": {"return": NOISE + 2.0, **dict.fromkeys(METRICS, np.zeros(64))}}

    def evaluate(*given, **named):
        # While it plays somebody else adds a row.
        leaderboard.write_board(path, with_row(read_board(path), row("theirs", NOISE)))
        asked.update(given=given, **named)
        return SimpleNamespace(scores=scores)

    monkeypatch.setattr(leaderboard, "evaluate", evaluate)
    main(["--file", str(path), "--add", "mine", "--policy", "forecast", "--about", "a rule"])
    given = ("paper", None, {"mine": "forecast"})
    assert asked == {"given": given, "episodes": 64, "seed": 3}
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "paper, 64 episodes of seed 3, the same for all"
    assert [line.split()[0] for line in lines[3:]] == ["mine", "none", "theirs"]
    assert [each["about"] for each in read_board(path)["rows"]] == ["made", "made", "a rule"]


def test_the_player_gets_the_means_of_medjaxs_own_policies(tmp_path):
    path = tmp_path / "known.json"
    rows = row("none", NOISE), row("mine", NOISE), row("pretrained_sampled", NOISE + 1)
    path.write_text(json.dumps(known_of(board(*rows))))
    known = read_evaluation(path)
    assert list(known["policies"]) == ["pretrained_sampled", "none"]
    assert known["policies"]["none"]["evs_depleted"] == 20.0
    low, high = known["policies"]["none"]["return_ci95"]
    assert low < known["policies"]["none"]["return_mean"] < high
    assert known["policies"]["none"]["verdict_ci95"] == {"ran out": [18.5, 21.5]}
    assert known["episodes"] == 64


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (["--add", "mine"], "policy"),
        (["--add", "\n", "--policy", "none"], "--add"),
        (["--policy", "none"], "--policy"),
        (["--again", "--add", "none"], "--again"),
    ],
)
def test_bad_input_is_refused_and_the_board_kept(path, capsys, given, word):
    before = path.read_bytes()
    assert word in refused(main, ["--file", str(path), *given], capsys)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        json.dumps({**board(row("a", [1.0])), "episodes": 2}),
        json.dumps({**board(), "seed": None}),
        json.dumps(board({"returns": [0.0] * 64})),
        json.dumps({**board(), "episodes": 0}),
        "[" * 100_000,
        json.dumps(board(row("a", ["x"] * 64))),
        json.dumps(board(row("a", [float("nan")] * 64))),
        json.dumps(board(row("a", [10**400] * 64))),
    ],
    ids=range(11),
)
def test_invalid_boards_are_refused(path, capsys, text):
    path.write_text(text)
    assert "board.json" in refused(main, ["--file", str(path)], capsys)


def test_a_pipe_is_refused(path, capsys):
    """Reading a pipe would wait until somebody writes to it."""
    path.unlink()
    os.mkfifo(path)
    assert "board.json is not a file" in refused(main, ["--file", str(path)], capsys)


def test_a_board_that_cannot_be_written_ends_it_in_a_line(path, monkeypatch, capsys):
    """As on a full disk, with exit code 1; the board is as it was."""
    before = path.read_bytes()

    def full(path, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(leaderboard, "play", lambda board, name, policy, about: row(name, NOISE))
    monkeypatch.setattr(leaderboard, "write_text", full)
    with pytest.raises(SystemExit) as end:
        main(["--file", str(path), "--add", "mine", "--policy", "none"])
    assert end.value.code == 1
    said = f"python -m benchmarks.leaderboard: cannot write {path}: No space left on device\n"
    assert capsys.readouterr().err == said
    assert path.read_bytes() == before
