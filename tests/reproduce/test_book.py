"""`python -m docs.reproduce` runs what is asked for, older than its files and needed, in its order."""

import json
import os
import signal
import warnings

import pytest

from docs.reproduce import __main__ as command
from docs.reproduce.__main__ import Book
from docs.reproduce.pages import Block, all_pages, blocks_of
from tests.reproduce.example import PAGE, PRINTED


@pytest.fixture
def book(tmp_path, monkeypatch):
    """A block that trains and one that plays; tests say what commands print."""
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    (tmp_path / "images").mkdir()
    (tmp_path / "reproduced.json").write_text("{}")
    (tmp_path / "counted.png").write_bytes(b"drawn")
    monkeypatch.setattr(command, "ROOT", tmp_path)
    monkeypatch.setattr(command, "STAMPS", tmp_path / "reproduced.json")
    monkeypatch.setattr(command, "WORK", tmp_path)
    learn = Block("learn", page, 600, (("train.ppo", "--run-dir", "runs/a"),))
    play = Block("count", page, 60, (("train.evaluate", "--run-dir", "runs/a"),))
    return Book({"count": play, "learn": learn})


@pytest.fixture(scope="module")
def everything():
    """All blocks of the pages."""
    return Book(blocks_of(*all_pages()))


def test_training_comes_before_what_plays_it(book, monkeypatch):
    """Training is not repeated, and an interrupted command continues after the finished blocks."""
    done, broken = [], False

    def output_of(block):
        if broken:
            raise RuntimeError("killed")
        done.append(block.name)
        return PRINTED

    monkeypatch.setattr(command, "output_of", output_of)
    count, learn = book.blocks["count"], book.blocks["learn"]
    assert book.order([count]) == [learn, count]
    book.run(learn)
    (command.WORK / "runs/a").mkdir(parents=True)
    broken, before = True, count.page.read_text()
    with pytest.raises(RuntimeError):
        book.run(count)
    assert count.page.read_text() == before
    broken, book = False, Book(book.blocks)  # as another process finds it
    assert book.order([count]) == [count]
    assert book.run(count)
    assert (command.WORK / "images/a.png").read_bytes() == b"drawn"
    assert done == ["learn", "count"]
    assert book.order([learn, count]) == []
    assert book.is_current(count)
    assert book.order([learn, count], again=True) == [learn, count]
    assert not book.run(count)
    assert book.seconds(learn) < 60
    # A block is older as soon as a file changes, or what its training depends on.
    other = Block("learn", learn.page, 600, (("train.ppo", "--seed", "1", "--run-dir", "runs/a"),))
    assert not Book({**book.blocks, "learn": other}).is_current(count)
    monkeypatch.setattr(command, "digest", lambda words, modules: "of other files")
    assert not book.is_current(count)
    assert "older than its files" in book.line(count)


def test_a_dry_run_runs_nothing(book, monkeypatch, capsys):
    """It lists what would run in its order, each block with its time, and their sum; names choose as without it."""
    monkeypatch.setattr(command, "blocks_of", lambda *pages: book.blocks)
    monkeypatch.setattr("docs.reproduce.pages.ROOT", command.ROOT)
    monkeypatch.setattr(command, "output_of", lambda block: pytest.fail(f"{block.name} ran"))

    def said(*words):
        assert command.main([*words, "--dry-run"]) == 0
        *lines, total = capsys.readouterr().out.splitlines()
        return [line.split()[0] for line in lines], lines, total

    names, lines, total = said("--all")
    assert names == ["learn", "count"]  # training first, though the page plays first
    assert " 10 min " in lines[0]
    assert " 60 s " in lines[1]
    assert total == "2 of 2 blocks to run, about 11 min"
    assert said("count")[0] == ["learn", "count"]
    assert said("learn")[0] == ["learn"]
    assert said() == ([], [], "0 of 0 blocks to run, about 0 s")  # both are long
    stamp = {"sources": book.digest(book.blocks["learn"]), "date": "today", "commit": "abc1234"}
    command.STAMPS.write_text(json.dumps({"learn": stamp}))
    (command.WORK / "runs/a").mkdir(parents=True)
    assert said("--all")[0] == ["count"]
    assert said("--all", "--again")[0] == ["count", "learn"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_the_running_command(name, book, monkeypatch, capsys):
    """Here the command itself sends it."""
    number, started = getattr(signal, name), command.WORK / "started"
    tell = f"open({str(started)!r}, 'w').write(str(os.getpid()))"
    slow = f"import os, time; {tell}; os.kill(os.getppid(), {int(number)}); time.sleep(600)"
    words = ("timeit", "-n1", "-r1", slow)
    block = Block("slow", book.blocks["count"].page, 1, (words,))
    monkeypatch.setattr(command, "blocks_of", lambda *pages: {"slow": block})
    monkeypatch.setattr(Block, "names", {"slow"})
    monkeypatch.setattr(command, "digest", lambda words, modules: "of these files")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert command.main(["slow"]) == 128 + number
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "interrupted\n"
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)


def test_long_blocks_run_only_by_name(everything, capsys):
    """A wrong name is refused in one line."""
    by_name, chosen = everything.blocks, everything.chosen
    quick = {block.name for block in chosen([])}
    assert {"calibrate", "highway", "figures"} <= quick
    assert not quick & {"learners", "evaluation", "six", "validation", "freight"}
    assert chosen(["six"]) == [by_name["six"]]
    assert {block.page.stem for block in chosen(["paper"])} >= {"paper"}
    assert chosen([], everything=True) == list(by_name.values())
    assert everything.needs(by_name["evaluation"]) == [by_name["learners"]]
    assert everything.needs(by_name["speeds-ippo"]) == [by_name["ippo"]]  # by a file of its run
    with pytest.raises(SystemExit) as end:
        command.main(["no-such-page", "--list"])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_blocks_older_than_their_files_are_named(everything):
    """A warning names them: their figures hold for an earlier tree."""
    assert everything.stamps.keys() <= everything.blocks.keys()
    older = [block.name for block in everything.blocks.values() if not everything.is_current(block)]
    if older:
        said = f"older than the files they depend on, or never run: {', '.join(older)}"
        warnings.warn(f"{said}; python -m docs.reproduce NAME", stacklevel=1)
