"""Files are written whole or not at all."""

import os

import pytest

from medjax.files import remove_unfinished, replacing, write_json, write_text


def test_a_file_is_replaced_whole_or_stays(tmp_path):
    path = tmp_path / "out.json"
    write_json(path, {"x": 1})
    assert path.read_text() == '{\n  "x": 1\n}\n'
    with pytest.raises(KeyError), replacing(path) as partial:
        {}[partial.write_text("half")]
    with pytest.raises(ValueError, match="nan"):
        write_json(path, {"x": float("nan")})
    assert path.read_text() == '{\n  "x": 1\n}\n'
    assert [*tmp_path.iterdir()] == [path]


def test_links_are_not_written_through(tmp_path):
    """Neither at the file's own name nor at a name of an earlier partial file."""
    precious = tmp_path / "precious"
    precious.write_text("precious")
    path = tmp_path / "config.json"
    path.symlink_to(precious)
    with replacing(path) as partial:
        seen = partial.name
        partial.write_text("new")
    assert path.read_text() == "new"
    assert not path.is_symlink()
    for planted in (seen, "config.partial.json"):
        (tmp_path / planted).symlink_to(precious)
        write_text(path, "newer")
    assert precious.read_text() == "precious"


def test_two_writers_do_not_collide(tmp_path):
    path = tmp_path / "out.txt"
    with replacing(path) as one, replacing(path) as other:
        one.write_text("one")
        other.write_text("other")
        assert one != other
    assert path.read_text() == "one"  # whole, from the writer that finished last


def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "out.txt", "x")
    finally:
        os.umask(before)
    assert (tmp_path / "out.txt").stat().st_mode & 0o777 == 0o640


def test_longest_file_names(tmp_path):
    for name in ("é" * 124 + ".json", "🚚" * 62):
        write_text(tmp_path / name, "x")
        assert (tmp_path / name).read_text() == "x"


def test_leftovers_of_a_killed_process_are_removed(tmp_path):
    (tmp_path / "precious.json").write_text("{}")
    with replacing(tmp_path / "out.json") as partial:
        copy = partial.with_name(partial.name.replace("out", "old"))
        copy.write_text("half")
    theirs = ["notes.partial.txt", "old.partial"]  # similar names of other programs
    (tmp_path / theirs[0]).write_text("mine")
    (tmp_path / theirs[1]).mkdir()
    remove_unfinished(tmp_path)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == sorted(["out.json", "precious.json", *theirs])
