"""Commands of the pages parse, and `python -m docs.reproduce` writes their output where it belongs."""

import os
import re
import runpy
import signal
import sys
import warnings

import pytest

from docs.reproduce import __main__ as command
from docs.reproduce.__main__ import Book
from docs.reproduce.pages import (
    FROM,
    ROOT,
    RUN,
    Block,
    all_pages,
    blocks_of,
    commands_in,
    selected,
    with_note,
    with_output,
)
from docs.reproduce.sources import files_of
from medjax.commandline import OneLineParser

PAGES = all_pages()
FENCE = re.compile(r"^```(?:bash)?\n(.*?)^```\n|^```\w+\n.*?^```\n", re.MULTILINE | re.DOTALL)
PAGE = """Before.

<!-- run count, 2 min -->
```
python -m benchmarks.calibrate \\
    --episodes 3
```

Of what it prints:

<!-- from count -->
```
old
```

<!-- from count: /^[ab]/ -->
```
old
```

<!-- from count: /^| n/,/^$/ -->
| old |
|---|

<!-- from count: counted.png -->
![A picture](images/a.png)

<!-- from other -->
```
stays
```
"""
PRINTED = "\na 1\nb 2  \nc 3\n\n| n | x |\n|---|---|\n| 1 | 2 |\n\nend\n"


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
    return Book(blocks_of(*PAGES))


class ParsedError(Exception):
    """The command line was parsed; nothing has run."""


@pytest.fixture
def parse_only(monkeypatch):
    """Ends commands behind their own parser."""
    whole = OneLineParser.parse_args

    def parse(*given):
        whole(*given)
        raise ParsedError

    monkeypatch.setattr(OneLineParser, "parse_args", parse)


def start(words, monkeypatch):
    """Runs a module as `python -m` does."""
    monkeypatch.setattr(sys, "argv", list(words))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # some are imported already
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_pages_parse(page, parse_only, tmp_path, monkeypatch, capsys):
    for folder in ("docs/images", "tests/data"):  # what commands write to
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    wrong = []
    fences = [found[1] for found in FENCE.finditer(page.read_text(encoding="utf-8")) if found[1]]
    for words in (words for fence in fences for words in commands_in(fence)):
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


def test_a_wrong_command_is_found(parse_only, monkeypatch):
    """The test above can fail."""
    with pytest.raises(SystemExit):
        start(["benchmarks.calibrate", "--no-such-option"], monkeypatch)


def test_output_is_on_the_page_of_its_command(everything):
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found = [*FROM.finditer(text)]
        comments = len(re.findall(r"^<!-- (?:run|from) ", text, re.MULTILINE))
        assert len(found) + len([*RUN.finditer(text)]) == comments, page
        assert {each["name"] for each in found} <= blocks_of(page).keys(), page
        for each in found:
            part = each["part"] or ""
            assert bool(each["picture"]) == (bool(part) and not part.startswith("/")), each[0]
    assert all(block.commands for block in everything.blocks.values())


def test_output_goes_where_a_page_wants_it():
    taken = []
    page = with_output(PAGE, "count", PRINTED, lambda *files: taken.append(files))
    assert "```\na 1\nb 2\nc 3\n\n| n | x |\n|---|---|\n| 1 | 2 |\n\nend\n```" in page
    assert "```\na 1\nb 2\n```" in page
    assert "<!-- from count: /^| n/,/^$/ -->\n```\na 1\nb 2\nc 3\n```" in page  # | is "or" there
    assert taken == [("counted.png", "images/a.png")]
    assert page.count("old") == 0
    assert page.endswith("```\nstays\n```\n")
    assert with_output(page, "count", PRINTED, lambda *files: None) == page
    # Markdown stays Markdown; a second table is not taken with it.
    page = with_output(PAGE.replace("/^| n/", r"/^\| n/"), "count", PRINTED, lambda *files: None)
    assert "-->\n| n | x |\n|---|---|\n| 1 | 2 |\n\n<!-- from count: counted.png" in page
    with pytest.raises(ValueError, match="nothing was printed"):
        selected("a\n\n", "/b/")


@pytest.mark.parametrize("comment", ["<!-- from count -->", "<!-- run more, 5 min -->"])
def test_a_comment_before_nothing_is_an_error(comment, tmp_path):
    """Otherwise the output of an hour's run would be lost."""
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert blocks_of(page).keys() == {"count"}
    with pytest.raises(ValueError, match="count is run in"):
        blocks_of(page, page)
    page.write_text(f"{PAGE}\n{comment}\n\nwords\n")
    with pytest.raises(ValueError, match=f"{comment} stands before no"):
        blocks_of(page)


def test_a_page_has_one_note_on_each_run():
    once = with_note(PAGE, "count", "*Run today.*")
    assert "    --episodes 3\n```\n\n*Run today.*\n\nOf what" in once
    assert with_note(once, "count", "*Run today.*") == once
    assert with_note(PAGE, "other", "*Run today.*") == PAGE


def test_files_that_a_command_depends_on():
    """A command depends on its imports and theirs, late ones included, and on other files that these read."""
    for module, among, absent in (
        (
            "benchmarks.calibrate",
            "benchmarks/studies/calibrate.py medjax/env/tick.py medjax/__init__.py",
            "tune|ppo.py|^train/ppo",
        ),
        ("medjax.render", "medjax/__init__.py medjax/render/web/player.js", "train/|benchmarks/"),
        ("medjax.render", "medjax/render/known/paper.json medjax/render/__main__.py", "docs/"),
        ("medjax.render", "medjax/policies/trained/paper.zip", r"\.md$"),
        (
            "benchmarks.generalization",
            "medjax/render/colors.py",
            r"\.js$",
        ),  # draws, shows no player
        ("train.ppo", "train/ppo.py", "benchmarks/"),
    ):
        names = {str(path.relative_to(ROOT)) for path in files_of([module])}
        assert set(among.split()) <= names
        assert not [name for name in names if re.search(absent, name)]


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
    assert not quick & {"learners", "evaluation", "tune", "validation", "planner-ppo"}
    assert chosen(["tune"]) == [by_name["tune"]]
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
