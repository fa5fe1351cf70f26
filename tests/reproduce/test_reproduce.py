"""What the pages print: their commands parse, and what `python -m docs.reproduce` writes goes where it belongs."""

import os
import re
import runpy
import signal
import sys
import warnings

import pytest

from docs.reproduce import __main__ as command
from docs.reproduce import run
from docs.reproduce.pages import (
    FROM,
    ROOT,
    RUN,
    Block,
    all_blocks,
    all_pages,
    blocks_of,
    fenced_commands,
    selected,
    with_note,
    with_output,
)
from docs.reproduce.sources import files_of
from medjax.commandline import OneLineParser
from tests.reproduce.conftest import PAGE, PRINTED

PAGES = all_pages()


class ParsedError(Exception):
    """The command line was understood; nothing has run."""


@pytest.fixture
def parse_only(monkeypatch):
    """Commands end where their own parser has read the command line."""
    whole = OneLineParser.parse_args

    def parse(*given):
        whole(*given)
        raise ParsedError

    monkeypatch.setattr(OneLineParser, "parse_args", parse)


def start(words, monkeypatch):
    """As `python -m` does."""
    monkeypatch.setattr(sys, "argv", list(words))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # some are imported already
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_fenced_commands_parse(page, parse_only, tmp_path, monkeypatch, capsys):
    """With the parser of the command itself; nothing is run."""
    for folder in ("docs/images", "tests/data"):  # what commands write to
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    wrong = []
    for words in fenced_commands(page):
        try:
            start(words, monkeypatch)
        except ParsedError:
            continue
        except SystemExit:
            said = capsys.readouterr().err.strip()
            if "cannot be read" not in said:  # a file that the command before would have written
                wrong.append(f"{' '.join(words)}: {said}")
        else:
            wrong.append(f"{words[0]}: has no parser")
    assert not wrong


def test_a_command_that_no_longer_parses_is_found(parse_only, monkeypatch):
    """The check above can fail."""
    with pytest.raises(SystemExit):
        start(["benchmarks.calibrate", "--no-such-option"], monkeypatch)


def test_comments_are_understood():
    """Every one stands before what it is meant for, and the command that is named is on the same page."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        read = [*RUN.finditer(text), *FROM.finditer(text)]
        assert len(read) == len(re.findall(r"^<!-- (?:run|from) ", text, re.MULTILINE)), page
        names = {block.name for block in blocks_of(page)}
        assert {found["name"] for found in FROM.finditer(text)} <= names, page
        for found in FROM.finditer(text):
            part = found["part"] or ""
            assert bool(found["picture"]) == (bool(part) and not part.startswith("/")), found[0]
    assert all(block.commands for block in all_blocks().values())


def test_output_goes_where_a_page_wants_it():
    """Whole, by lines, from line to line, and as a picture; the rest stays, and so does all when written again."""
    taken = []
    page = with_output(PAGE, "count", PRINTED, lambda *files: taken.append(files))
    assert "```\na 1\nb 2\nc 3\n\n| n | x |\n|---|---|\n| 1 | 2 |\n\nend\n```" in page
    assert "```\na 1\nb 2\n```" in page
    assert "<!-- from count: /^| n/,/^$/ -->\n```\na 1\nb 2\nc 3\n```" in page  # | is "or" there
    assert taken == [("counted.png", "images/a.png")]
    assert page.count("old") == 0
    assert page.endswith("```\nstays\n```\n")
    assert with_output(page, "count", PRINTED, lambda *files: None) == page


def test_printed_tables_stay_tables():
    """Markdown that a command prints is the page's own; a second table is not taken with it."""
    page = PAGE.replace("/^| n/", r"/^\| n/")
    page = with_output(page, "count", PRINTED, lambda *files: None)
    assert "-->\n| n | x |\n|---|---|\n| 1 | 2 |\n\n<!-- from count: counted.png" in page


def test_nothing_printed_is_an_error():
    """A page is not emptied by a command that prints something else now."""
    with pytest.raises(ValueError, match="nothing was printed"):
        selected("a\n\n", "/b/")


@pytest.mark.parametrize("comment", ["<!-- from count -->", "<!-- run more, 5 min -->"])
def test_a_comment_before_nothing_is_an_error(comment, tmp_path):
    """What a command prints after an hour would go nowhere."""
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert blocks_of(page)
    page.write_text(f"{PAGE}\n{comment}\n\nwords\n")
    with pytest.raises(ValueError, match=f"{comment} stands before no"):
        blocks_of(page)


def test_a_page_says_when_its_command_was_run():
    """Once, however often."""
    once = with_note(PAGE, "count", "*Run today.*")
    assert "    --episodes 3\n```\n\n*Run today.*\n\nOf what" in once
    assert with_note(once, "count", "*Run today.*") == once
    assert with_note(PAGE, "other", "*Run today.*") == PAGE


def test_what_a_command_depends_on():
    """Its imports and theirs, late ones too, and what is no Python beside them; no other command."""
    names = {str(path.relative_to(ROOT)) for path in files_of(["benchmarks.calibrate"])}
    assert {"benchmarks/studies/calibrate.py", "medjax/env/tick.py", "medjax/__init__.py"} <= names
    assert not {name for name in names if "studies/tune" in name or name.startswith("train/ppo")}
    names = {str(path.relative_to(ROOT)) for path in files_of(["medjax.render"])}
    assert {"medjax/render/web/player.js", "medjax/render/__main__.py"} <= names
    assert {"medjax/render/known/paper.json", "medjax/policies/trained/paper.zip"} <= names
    # Its pictures have the player's colours, and none of its scripts.
    names = {str(path.relative_to(ROOT)) for path in files_of(["benchmarks.generalization"])}
    assert "medjax/render/colors.py" in names
    assert not any(name.endswith(".js") for name in names)
    assert "train/ppo.py" in {str(path.relative_to(ROOT)) for path in files_of(["train.ppo"])}


def test_training_comes_before_what_plays_it(book, monkeypatch):
    """And is not done again; what was interrupted goes on; what is of its files is left alone."""
    done = []

    def printed(block):
        """Fails where it is asked to."""
        if broken:
            raise RuntimeError("killed")
        done.append(block.name)
        return PRINTED

    monkeypatch.setattr(run, "_printed", printed)
    count, learn = book.blocks["count"], book.blocks["learn"]
    assert book.order([count], again=False) == [learn, count]
    broken = False
    book.run(learn)
    (run.WORK / "runs/a").mkdir(parents=True)
    broken, before = True, count.page.read_text()
    with pytest.raises(RuntimeError):
        book.run(count)
    assert count.page.read_text() == before
    broken, book = False, run.Book(book.blocks)  # as another process finds it
    assert book.order([count], again=False) == [count]
    assert book.run(count)
    assert (run.WORK / "images/a.png").read_bytes() == b"drawn"
    assert done == ["learn", "count"]
    assert book.order([learn, count], again=False) == []
    assert book.order([learn, count], again=True) == [learn, count]
    assert not book.run(count)
    assert book.seconds(learn) < 60


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_the_command_that_is_under_way(name, book, monkeypatch, capsys):
    """In a line, and with its exit code; here the command itself sends it."""
    number, started = getattr(signal, name), run.WORK / "started"
    slow = (
        "import os, time; "
        f"open({str(started)!r}, 'w').write(str(os.getpid())); "
        f"os.kill(os.getppid(), {int(number)}); time.sleep(600)"
    )
    words = ("timeit", "-n1", "-r1", slow)
    block = Block("slow", book.blocks["count"].page, 1, (words,))
    monkeypatch.setattr(command, "all_blocks", lambda: {"slow": block})
    monkeypatch.setattr(command, "ROOT", run.ROOT)
    monkeypatch.setattr(run, "digest", lambda words, modules: "of these files")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert command.main(["slow"]) == 128 + number
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "interrupted\n"
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)


def test_an_older_block_is_known_by_its_files(book, monkeypatch):
    """Not of its files any more when one of them changes, or one that its training depends on."""
    monkeypatch.setattr(run, "_printed", lambda block: PRINTED)
    count, learn = book.blocks["count"], book.blocks["learn"]
    book.run(learn)
    book.run(count)
    assert book.is_current(count)
    other = Block("learn", learn.page, 600, (("train.ppo", "--seed", "1", "--run-dir", "runs/a"),))
    assert not run.Book({**book.blocks, "learn": other}).is_current(count)
    monkeypatch.setattr(run, "digest", lambda words, modules: "of other files")
    assert not book.is_current(count)
    assert "older than its files" in book.state(count)


def test_long_blocks_are_run_when_they_are_named(book, capsys, monkeypatch):
    """Without names only what is quick, with all that it needs; a wrong name is refused in a line."""
    everything = run.Book(all_blocks())
    quick = {block.name for block in command.chosen([], False, everything)}
    assert {"calibrate", "highway", "figures"} <= quick
    assert not quick & {"learners", "evaluation", "tune", "validation", "planner-ppo"}
    assert {b.name for b in command.chosen(["tune"], False, everything)} == {"tune"}
    assert {b.page.stem for b in command.chosen(["paper"], False, everything)} >= {"paper"}
    assert command.chosen([], True, everything) == list(everything.blocks.values())
    by_name = everything.blocks
    assert everything.needs(by_name["evaluation"]) == [by_name["learners"]]
    assert everything.needs(by_name["speeds-ippo"]) == [by_name["ippo"]]  # by a file of its run
    with pytest.raises(SystemExit) as end:
        command.main(["no-such-page", "--dry-run"])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_blocks_that_are_older_than_their_files_are_named():
    """In a warning: they are true of an earlier tree, not wrong."""
    book = run.Book(all_blocks())
    assert book.stamps.keys() <= book.blocks.keys()
    older = [block.name for block in book.blocks.values() if not book.is_current(block)]
    if older:
        said = f"older than the files they depend on, or never run: {', '.join(older)}"
        warnings.warn(f"{said}; python -m docs.reproduce NAME", stacklevel=1)
