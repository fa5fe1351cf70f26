"""What in the pages is printed by which command, and where what a command prints goes.

A comment stands before a command, another before each thing that comes from it:

    <!-- run NAME, 2 min -->            before a fenced command; how long it takes, about
    <!-- from NAME -->                  before a fenced block, or tables: all that the command prints
    <!-- from NAME: /REGEX/ -->         only the lines that the expression is found in
    <!-- from NAME: /REGEX/,/REGEX/ --> from the first line with the one to the line before the other
    <!-- from NAME: FILE -->            before a picture or an <iframe> of the page, which shows the file that the
                                        command wrote
"""

from __future__ import annotations

import dataclasses
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECONDS = {"s": 1, "min": 60, "h": 3600}
OURS = ("medjax", "train", "benchmarks", "docs")  # packages whose commands are run

FENCE = re.compile(r"^```(\w*)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
RUN = re.compile(
    r"^<!-- run (?P<name>[\w-]+), (?P<time>\d+) (?P<unit>s|min|h) -->\n"
    r"(?P<fence>```\w*\n(?P<commands>(?:(?!```).*\n)+)```\n)(?P<note>\n\*Run .*\*\n)?",
    re.MULTILINE,
)
COMMENT = re.compile(r"^<!-- (?:run|from) .*$", re.MULTILINE)
RUN_NOTE = "*Run {date} in {time}: {commit}, {versions}, {machine}.*"
FROM = re.compile(
    r"^(?P<head><!-- from (?P<name>[\w-]+)(?:: (?P<part>.+))? -->\n)"
    r"(?P<body>```\n(?:(?!```).*\n)*```\n|(?:!\[[^]]*\]\(|<iframe src=\x22)"
    r"(?P<picture>[^)\x22]+)[)\x22].*\n|(?:\|.*\n)+)",
    re.MULTILINE,
)


@dataclasses.dataclass(frozen=True)
class Block:
    """A command of a page, or a few that are run one after the other."""

    name: str
    page: Path
    expected_s: int
    commands: tuple[tuple[str, ...], ...]  # module and arguments of each
    has_pictures: bool = False  # its page shows files that it writes

    @property
    def learns(self) -> set[str]:
        """Run directories that it makes."""
        return {
            _after("--run-dir", words)
            for words in self.commands
            if words[0] == "train.ppo" and "--run-dir" in words
        }

    @property
    def reads(self) -> set[str]:
        """Run directories that others made."""
        return {word for words in self.commands for word in words[1:]} - self.learns


def _after(option: str, words: tuple[str, ...]) -> str:
    return words[words.index(option) + 1]


def all_pages() -> list[Path]:
    """README.md, CONTRIBUTING.md and docs/."""
    outside = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    return [*outside, *sorted((ROOT / "docs").rglob("*.md"))]


def commands_in(fence: str) -> Iterator[tuple[str, ...]]:
    """Module and arguments of our own commands in a fenced block; other programs' are left out."""
    for line in fence.replace("\\\n", " ").splitlines():
        for found in re.finditer(r"python -m ((?:\w+)(?:\.\w+)*)([^;&)]*)", line):
            if found[1].partition(".")[0] in OURS:
                yield (found[1], *shlex.split(found[2], comments=True))


def fenced_commands(page: Path) -> Iterator[tuple[str, ...]]:
    """All of our commands that a page has in fenced blocks."""
    for fence in FENCE.finditer(page.read_text(encoding="utf-8")):
        if fence[1] in ("", "bash"):
            yield from commands_in(fence[2])


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page, in order.

    Raises:
      ValueError: a comment stands before nothing that it could be of.
    """
    text = page.read_text(encoding="utf-8")
    known = {found.start() for kind in (RUN, FROM) for found in kind.finditer(text)}
    if lost := [each[0] for each in COMMENT.finditer(text) if each.start() not in known]:
        raise ValueError(f"{page}: {lost[0]} stands before no fenced block, table or picture")
    drawn = {found["name"] for found in FROM.finditer(text) if found["picture"]}
    return [
        Block(
            name=found["name"],
            page=page,
            expected_s=int(found["time"]) * SECONDS[found["unit"]],
            commands=tuple(commands_in(found["commands"])),
            has_pictures=found["name"] in drawn,
        )
        for found in RUN.finditer(text)
    ]


def all_blocks() -> dict[str, Block]:
    """The blocks of all pages by name.

    Raises:
      ValueError: a name is given twice, or as `blocks_of`.
    """
    found: dict[str, Block] = {}
    for page in all_pages():
        for block in blocks_of(page):
            if block.name in found:
                raise ValueError(f"{block.name} is run in {found[block.name].page} and in {page}")
            found[block.name] = block
    return found


def with_note(text: str, name: str, note: str) -> str:
    """The page with a line behind a command that says when and on what it was run."""

    def noted(found: re.Match[str]) -> str:
        if found["name"] != name:
            return found[0]
        head = found[0][: found.start("fence") - found.start()]
        return f"{head}{found['fence']}\n{note}\n"

    return RUN.sub(noted, text)


def with_output(text: str, name: str, printed: str, take: Callable[[str, str], None]) -> str:
    """The page with what a command printed in its places; `take(file, picture)` is called for each picture."""

    def filled(found: re.Match[str]) -> str:
        if found["name"] != name:
            return found[0]
        if found["picture"]:
            take(found["part"], found["picture"])
            return found[0]
        lines = selected(printed, found["part"])
        if all(line.startswith("|") for line in lines if line):
            return found["head"] + "\n".join(lines) + "\n"
        return found["head"] + "\n".join(["```", *lines, "```"]) + "\n"

    return FROM.sub(filled, text)


def selected(printed: str, part: str | None) -> list[str]:
    """The lines of an output that a comment asks for, without blank ones at the ends.

    Raises:
      ValueError: there are none.
    """
    lines = [line.rstrip() for line in printed.splitlines()]
    if part:
        first, _, last = part.strip("/").partition("/,/")
        if last:
            start = next((n for n, line in enumerate(lines) if re.search(first, line)), len(lines))
            lines = lines[start:]
            end = next((n for n, line in enumerate(lines[1:], 1) if re.search(last, line)), None)
            lines = lines[:end]
        else:
            lines = [line for line in lines if re.search(first, line)]
    while lines and not lines[0]:
        lines.pop(0)
    while lines and not lines[-1]:
        lines.pop()
    if not lines:
        raise ValueError(f"nothing was printed that {part or 'a page'} shows")
    return lines
