"""The commands whose output pages show, and the places where that output goes.

A comment stands before each command, and before each thing that comes from its output:

    <!-- run NAME, 2 min -->            before a fenced command; its usual duration
    <!-- from NAME -->                  before a fenced block or table: the whole output
    <!-- from NAME: /REGEX/ -->         only the lines that match
    <!-- from NAME: /REGEX/,/REGEX/ --> from the first line that matches the one to the line before the other
    <!-- from NAME: FILE -->            before a picture or an <iframe>, which shows a file that the command wrote
"""

import dataclasses
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECONDS = {"s": 1, "min": 60, "h": 3600}
OURS = ("medjax", "train", "benchmarks", "docs")  # packages whose commands are run

RUN = re.compile(
    r"^<!-- run (?P<name>[\w-]+), (?P<time>\d+) (?P<unit>s|min|h) -->\n"
    r"(?P<fence>```\w*\n(?P<commands>(?:(?!```).*\n)+)```\n)(?P<note>\n\*Run .*\*\n)?",
    re.MULTILINE,
)
COMMENT = re.compile(r"^<!-- (?:run|from) .*$", re.MULTILINE)
FROM = re.compile(
    r"^(?P<head><!-- from (?P<name>[\w-]+)(?:: (?P<part>.+))? -->\n)"
    r"(?P<body>```\n(?:(?!```).*\n)*```\n|(?:!\[[^]]*\]\(|<iframe src=\x22)"
    r"(?P<picture>[^)\x22]+)[)\x22].*\n|(?:\|.*\n)+)",
    re.MULTILINE,
)


@dataclasses.dataclass(frozen=True)
class Block:
    """A command of a page, or a few that run one after the other."""

    name: str
    page: Path
    expected_s: int
    commands: tuple[tuple[str, ...], ...]  # module and arguments of each

    @property
    def names(self) -> set[str]:
        """The names that select it."""
        return {self.name, self.page.stem, str(self.page.relative_to(ROOT))}

    @property
    def words(self) -> list[str]:
        """All words of all commands."""
        return [word for words in self.commands for word in words]

    @property
    def learns(self) -> set[str]:
        """Run directories that its training makes."""
        return {
            words[words.index("--run-dir") + 1]
            for words in self.commands
            if words[0] == "train.ppo" and "--run-dir" in words
        }


def all_pages() -> list[Path]:
    """README.md, CONTRIBUTING.md and docs/."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands_in(fence: str) -> Iterator[tuple[str, ...]]:
    """Module and arguments of each of our commands in a fenced block; other programs are left out."""
    for line in fence.replace("\\\n", " ").splitlines():
        for found in re.finditer(r"python -m ((?:\w+)(?:\.\w+)*)([^;&)]*)", line):
            if found[1].partition(".")[0] in OURS:
                yield (found[1], *shlex.split(found[2], comments=True))


def blocks_of(*pages: Path) -> dict[str, Block]:
    """The blocks of pages by name; ValueError for a comment that marks nothing, and for a name given twice."""
    found: dict[str, Block] = {}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        known = {each.start() for kind in (RUN, FROM) for each in kind.finditer(text)}
        if lost := [each[0] for each in COMMENT.finditer(text) if each.start() not in known]:
            raise ValueError(f"{page}: {lost[0]} stands before no fenced block, table or picture")
        for each in RUN.finditer(text):
            name, seconds = each["name"], int(each["time"]) * SECONDS[each["unit"]]
            if name in found:
                raise ValueError(f"{name} is run in {found[name].page} and in {page}")
            found[name] = Block(name, page, seconds, tuple(commands_in(each["commands"])))
    return found


def with_note(text: str, name: str, note: str) -> str:
    """The page with `note` behind the command `name`, in place of an earlier one."""

    def noted(found: re.Match[str]) -> str:
        before = found[0].removesuffix(found["note"] or "")
        return f"{before}\n{note}\n" if found["name"] == name else found[0]

    return RUN.sub(noted, text)


def with_output(text: str, name: str, printed: str, take: Callable[[str, str], object]) -> str:
    """The page with a command's output in its places; calls `take(file, picture)` for each picture."""

    def filled(found: re.Match[str]) -> str:
        if found["name"] != name:
            return found[0]
        if found["picture"]:
            take(found["part"], found["picture"])
            return found[0]
        lines = selected(printed, found["part"])
        if not all(line.startswith("|") for line in lines if line):
            lines = ["```", *lines, "```"]
        return found["head"] + "\n".join(lines) + "\n"

    return FROM.sub(filled, text)


def selected(printed: str, part: str | None) -> list[str]:
    """The lines of an output that a comment asks for, without blank ends; ValueError if there are none."""
    lines = [line.rstrip() for line in printed.splitlines()]
    first, _, last = (part or "").strip("/").partition("/,/")
    fits = [number for number, line in enumerate(lines) if re.search(first, line)]
    if fits and last:
        ends = (n for n in range(fits[0] + 1, len(lines)) if re.search(last, lines[n]))
        fits = [*range(fits[0], next(ends, len(lines)))]
    text = "\n".join(lines[number] for number in fits).strip("\n")
    if not text:
        raise ValueError(f"nothing was printed that {part or 'a page'} shows")
    return text.split("\n")
