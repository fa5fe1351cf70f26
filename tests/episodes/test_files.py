"""Trajectory files read back by pyarrow and pandas."""

import numpy as np
import pytest

import medjax.episodes.files
from medjax.episodes.files import write_trajectories


def test_parquet_reads_back_as_the_table(played, table, tmp_path):
    """Written in pieces; compared with the table of the whole."""
    parquet = pytest.importorskip("pyarrow.parquet", reason='pip install -e ".[trajectories]"')
    path = tmp_path / "run.parquet"
    assert write_trajectories(played[0], path) == len(table["time_s"])
    back = parquet.read_table(path)
    assert back.column_names == list(table)
    for name, column in table.items():
        mask = np.ma.getmaskarray(column)
        assert back[name].null_count == mask.sum()
        values = np.asarray(back[name].drop_null().to_pylist())
        np.testing.assert_array_equal(values, column.compressed())
    played = back.schema.metadata[b"medjax"].decode()
    assert '"scenario": "paper"' in played
    assert '"policy": "paced"' in played


def test_csv_reads_back_as_the_table(played, table):
    pandas = pytest.importorskip("pandas")
    back = pandas.read_csv(played[1], dtype={"booked_med_id": "Int64"})
    assert list(back.columns) == list(table)
    for name, column in table.items():
        mask = np.ma.getmaskarray(column)
        np.testing.assert_array_equal(back[name].isna(), mask)
        values = back[name][~mask].to_numpy()
        np.testing.assert_array_equal(values.astype(column.dtype), column.compressed())


def test_a_failed_write_leaves_the_old_file(recording, tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("old")

    def fails(pieces, file):
        yield file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setitem(medjax.episodes.files.FORMATS, ".csv", fails)
    with pytest.raises(OSError, match="No space left"):
        write_trajectories(recording, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
