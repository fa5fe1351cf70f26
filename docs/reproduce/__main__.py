"""Writes the output of commands into README.md and docs/: every block, table and picture that a comment marks.

Without names: what takes two minutes or less. The name of a page or of a block runs that, however long it takes.
Blocks whose files have not changed are left alone, so the same command continues where it was interrupted.
With --dry-run it only says which blocks it would run, and how long they take.
Commands run in build/reproduce; docs/reproduced.json says what ran when, and on what.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from datetime import date
from typing import Any

from docs.reproduce.pages import ROOT, Block, all_pages, blocks_of, with_note, with_output
from docs.reproduce.sources import digest
from medjax.commandline import OneLineParser, command, in_words, leave
from medjax.errors import shown
from train.runs.versions import versions

STAMPS = ROOT / "docs/reproduced.json"
WORK = ROOT / "build/reproduce"  # where commands run and leave their files
RUN_NOTE = "*Run {date} in {time}: commit {commit}, JAX {jax}, Python {python}, {machine}.*"
QUICK_S = 120


class Book:
    """All blocks, and a stamp of the last run of each."""

    def __init__(self, blocks: Mapping[str, Block]) -> None:
        self.blocks = blocks
        self.stamps: dict[str, dict[str, Any]] = json.loads(STAMPS.read_text(encoding="utf-8"))

    def needs(self, block: Block) -> list[Block]:
        """Blocks that train what this one plays."""
        reads = [f"{word}/" for word in block.words if word not in block.learns]
        return [
            other
            for other in self.blocks.values()
            if any(word.startswith(f"{run}/") for run in other.learns for word in reads)
        ]

    def digest(self, block: Block) -> str:
        """Digest of its commands, of the files that they depend on, and of the blocks that it needs."""
        words = block.words + [self.digest(other) for other in self.needs(block)]
        return digest(words, [words[0] for words in block.commands])

    def is_current(self, block: Block) -> bool:
        """Whether the last run had these files."""
        return self.stamps.get(block.name, {}).get("sources") == self.digest(block)

    def seconds(self, *blocks: Block) -> int:
        """Duration of the last runs, or what the pages expect."""
        return sum(self.stamps.get(b.name, {}).get("seconds", b.expected_s) for b in blocks)

    def line(self, block: Block) -> str:
        """A line of --list and --dry-run."""
        stamp = self.stamps.get(block.name, {"date": "never run", "commit": "by this command"})
        state = "" if self.is_current(block) else "older than its files: "
        page, time = block.page.relative_to(ROOT), in_words(self.seconds(block))
        return f"{block.name:<32} {page!s:<20} {time:>7}  {state}{stamp['date']}, {stamp['commit']}"

    def chosen(self, names: Collection[str], everything: bool = False) -> list[Block]:
        """The blocks of these names or pages (ValueError: unknown); without names the quick ones, or everything."""
        blocks, asked = self.blocks.values(), {*names}
        if unknown := asked.difference(*(block.names for block in blocks)):
            allowed = sorted({name for block in blocks for name in block.names})
            raise ValueError(f"{shown(min(unknown))}: allowed {', '.join(allowed)}")
        if asked:
            return [block for block in blocks if block.names & asked]
        return [b for b in blocks if everything or self.seconds(b, *self.needs(b)) <= QUICK_S]

    def order(self, chosen: Collection[Block], again: bool = False) -> list[Block]:
        """The chosen blocks that are not current, each behind the training that it needs."""
        todo: dict[str, Block] = {}
        for block in chosen:
            if again or not self.is_current(block):
                makers = [each for each in self.needs(block) if not self._is_made(each)]
                todo |= {each.name: each for each in (*makers, block)}
        return list(todo.values())

    def _is_made(self, block: Block) -> bool:
        return self.is_current(block) and all((WORK / run).is_dir() for run in block.learns)

    def run(self, block: Block) -> bool:
        """Runs a block, then writes its page and its stamp. Returns whether the page's figures have changed."""
        began, sources, ran = time.monotonic(), self.digest(block), versions()
        printed = output_of(block)
        seconds = round(time.monotonic() - began)
        stamp = {
            "page": str(block.page.relative_to(ROOT)),
            "command": [" ".join(words) for words in block.commands],
            "commit": ran["commit"],
            "date": date.today().isoformat(),
            "seconds": seconds,
            "machine": f"{os.cpu_count()} cores, {platform.machine()}",
            "versions": {name: ran[name] for name in ("python", "jax", "numpy")},
            "sources": sources,
        }

        def take(file: str, picture: str) -> None:
            shutil.copyfile(WORK / file, block.page.parent / picture)

        before = block.page.read_text(encoding="utf-8")
        after = with_output(before, block.name, printed, take)
        note = RUN_NOTE.format(**ran | stamp, time=in_words(seconds))
        block.page.write_text(with_note(after, block.name, note), encoding="utf-8")
        self.stamps = dict(sorted({**self.stamps, block.name: stamp}.items()))
        STAMPS.write_text(json.dumps(self.stamps, indent=2) + "\n", encoding="utf-8")
        return before != after


def output_of(block: Block) -> str:
    """Runs the commands of a block (CalledProcessError: one failed) and returns the output of the last."""
    WORK.mkdir(parents=True, exist_ok=True)
    for directory in block.learns:  # training starts anew
        shutil.rmtree(WORK / directory, ignore_errors=True)
    printed, ours = "", os.environ | {"PYTHONPATH": str(ROOT)}
    for words in block.commands:
        line = [sys.executable, "-m", *words]
        printed = subprocess.check_output(line, cwd=WORK, env=ours, text=True)
    return printed


@command
def main(argv: Sequence[str] | None = None) -> int:
    """The command. Returns the exit code: 2 for bad input, 1 where a command failed."""
    parser = OneLineParser(prog="python -m docs.reproduce", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="PAGE", help="pages (paper) or blocks")
    parser.add_argument("--all", action="store_true", help="include long blocks: many hours")
    parser.add_argument("--again", action="store_true", help="include blocks that are current")
    parser.add_argument("--list", action="store_true", help="list the blocks, run nothing")
    parser.add_argument("--dry-run", action="store_true", help="say what would run, and how long")
    given = parser.parse_args(argv)
    try:
        book = Book(blocks_of(*all_pages()))
        wanted = book.chosen(given.names, given.all or given.list)
    except ValueError as error:
        parser.error(str(error))
    if given.list:
        print(*map(book.line, wanted), sep="\n")
        return 0
    todo = book.order(wanted, given.again)
    if given.dry_run and todo:
        print(*map(book.line, todo), sep="\n")
    print(
        f"{len(todo)} of {len(wanted)} blocks to run, about {in_words(book.seconds(*todo))}",
        flush=True,
    )
    if given.dry_run:
        return 0
    for block in todo:
        print(f"{block.name}: about {in_words(book.seconds(block))}", flush=True)
        try:
            changed = book.run(block)
        except (subprocess.CalledProcessError, ValueError, OSError) as error:
            print(f"{parser.prog}: {error}", file=sys.stderr)
            return 1
        said = "figures changed: read what the page says about them" if changed else "as before"
        print(f"{block.name}: {in_words(book.seconds(block))}, {said}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
