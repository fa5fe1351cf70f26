"""Pictures of studies."""

import errno
from pathlib import Path

import pytest

from benchmarks.studies.drawing import draw_rows, finish
from train.reporting.figures import new_figure

ROWS = [{"policy": "none", "x": x, "y": 2.0, "y_ci95": [1.0, 3.5]} for x in (0.0, 1.0)]


def draw(path):
    """Draws a panel with one policy."""
    figure = new_figure(3.0, 2.0)
    axes = figure.add_subplot()
    draw_rows(axes, ROWS, "x", "y", 0, label="none")
    finish(figure, {axes: ("x, m", "y, m")}, "made", 5, path)


def test_a_picture_is_written_in_full_or_not_at_all(tmp_path, monkeypatch):
    """A full disk leaves the earlier picture as it was."""
    path = tmp_path / "study.png"
    draw(path)
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")

    def full(self, file, **_):
        Path(file).write_bytes(b"half")
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(OSError, match="full"):
        draw(path)
    assert [file.name for file in tmp_path.iterdir()] == ["study.png"]
    assert path.read_bytes() == before
