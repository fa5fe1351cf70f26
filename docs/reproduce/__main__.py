"""Prints every block, table and picture of README.md and docs/ anew, into the pages.

Without names: what takes two minutes or less. The name of a page or of a block runs that, however long it takes.
What was run on the files as they are is left alone, so that the same command goes on where it was interrupted.
Commands run in build/reproduce; docs/reproduced.json says what was run when, and on what.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from docs.reproduce.pages import ROOT, Block, all_blocks
from docs.reproduce.run import Book
from docs.reproduce.same import is_commit, keep
from medjax.commandline import OneLineParser, command, in_words, leave
from medjax.errors import shown

QUICK_S = 120


def build_parser() -> OneLineParser:
    """The command line."""
    parser = OneLineParser(prog="python -m docs.reproduce", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="PAGE", help="pages (paper) or blocks")
    parser.add_argument("--all", action="store_true", help="long ones too: many hours")
    parser.add_argument("--again", action="store_true", help="also what is of these files")
    parser.add_argument("--list", action="store_true", help="say what there is, run nothing")
    parser.add_argument("--dry-run", action="store_true", help="say what would be run")
    same = "keep what these commits printed where this tree computes the same bits; minutes"
    parser.add_argument("--same-bits-as", nargs="+", metavar="COMMIT", help=same)
    return parser


def chosen(names: Sequence[str], everything: bool, book: Book) -> list[Block]:
    """The blocks that are asked for.

    Raises:
      ValueError: a name is neither a page's nor a block's.
    """
    blocks = list(book.blocks.values())
    known = {name for block in blocks for name in _names(block)}
    for name in names:
        if name not in known:
            raise ValueError(f"{shown(name)}: allowed {', '.join(sorted(known))}")
    if names:
        return [block for block in blocks if _names(block) & set(names)]
    return [block for block in blocks if everything or _whole_s(block, book) <= QUICK_S]


def _names(block: Block) -> set[str]:
    """What a block answers to."""
    return {block.name, block.page.stem, str(block.page.relative_to(ROOT))}


def _whole_s(block: Block, book: Book) -> int:
    """Its time, with what it needs, as its page says."""
    return block.expected_s + sum(_whole_s(other, book) for other in book.needs(block))


def keep_same(book: Book, commits: Sequence[str]) -> int:
    """Says which blocks are kept. Returns the exit code."""
    try:
        names = keep(book, commits)
    except subprocess.CalledProcessError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{len(names)} blocks are of these files, too: {', '.join(names)}")
    return 0


@command
def main(argv: Sequence[str] | None = None) -> int:
    """The command. Returns the exit code: 2 for bad input, 1 where a command failed."""
    parser = build_parser()
    given = parser.parse_args(argv)
    try:
        book = Book(all_blocks())
        wanted = chosen(given.names, given.all or given.list, book)
    except ValueError as error:
        parser.error(str(error))
    for commit in given.same_bits_as or ():
        if not is_commit(commit):
            parser.error(f"--same-bits-as {shown(commit)}: allowed commits of this repository")
    if given.same_bits_as:
        return keep_same(book, given.same_bits_as)
    if given.list:
        for block in wanted:
            page = block.page.relative_to(ROOT)
            time = in_words(book.seconds(block))
            print(f"{block.name:<22} {page!s:<22} {time:>7}  {book.state(block)}")
        return 0
    todo = book.order(wanted, given.again)
    left = sum(book.seconds(block) for block in todo)
    print(f"{len(todo)} of {len(wanted)} blocks to run, about {in_words(left)}", flush=True)
    for block in todo:
        print(f"{block.name}: about {in_words(book.seconds(block))}", flush=True)
        if given.dry_run:
            continue
        try:
            changed = book.run(block)
        except (RuntimeError, ValueError, OSError) as error:
            print(f"{parser.prog}: {error}", file=sys.stderr)
            return 1
        said = (
            "what it prints has changed: read what the page says of it" if changed else "as before"
        )
        print(f"{block.name}: {in_words(book.seconds(block))}, {said}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
