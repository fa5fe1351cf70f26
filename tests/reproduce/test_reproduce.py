"""Commands of the pages parse, and their output goes where it belongs."""

import re
import runpy
import sys
import warnings

import pytest

from docs.reproduce.pages import (
    FROM,
    ROOT,
    RUN,
    all_pages,
    blocks_of,
    commands_in,
    selected,
    with_note,
    with_output,
)
from docs.reproduce.sources import files_of
from medjax.commandline import OneLineParser
from tests.reproduce.example import PAGE, PRINTED

PAGES = all_pages()
FENCE = re.compile(r"^```(?:bash)?\n(.*?)^```\n|^```\w+\n.*?^```\n", re.MULTILINE | re.DOTALL)


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


def test_output_is_on_the_page_of_its_command():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found = [*FROM.finditer(text)]
        comments = len(re.findall(r"^<!-- (?:run|from) ", text, re.MULTILINE))
        assert len(found) + len([*RUN.finditer(text)]) == comments, page
        assert {each["name"] for each in found} <= blocks_of(page).keys(), page
        for each in found:
            part = each["part"] or ""
            assert bool(each["picture"]) == (bool(part) and not part.startswith("/")), each[0]
    assert all(block.commands for block in blocks_of(*PAGES).values())


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
