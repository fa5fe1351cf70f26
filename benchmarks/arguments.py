"""What the benchmarks' command lines share: bad input is one line on stderr and exit code 2."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

from train.cli import OneLineParser


def benchmark_parser(name: str, description: str | None) -> OneLineParser:
    """The parser of `python -m benchmarks.NAME`, with `--json FILE`."""
    parser = OneLineParser(
        prog=f"python -m benchmarks.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--json", type=output_file, metavar="FILE", help="write the figures here too"
    )
    return parser


def whole_number(least: int = 1, most: int | None = None) -> Callable[[str], int]:
    """A type of argument: whole numbers from `least`, to `most` if it is given."""
    allowed = f"a whole number from {least}" + (f" to {most}" if most else "")

    def parse(text: str) -> int:
        if not text.isdecimal() or int(text) < least or (most and int(text) > most):
            raise argparse.ArgumentTypeError(f"{text!r}: allowed {allowed}")
        return int(text)

    return parse


positive = whole_number()


def output_file(text: str) -> Path:
    """A type of argument: a file that can be written, checked before anything is measured."""
    path = Path(text)
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise argparse.ArgumentTypeError(
            f"{text!r}: allowed a file in a directory that exists and is writable"
        )
    return path
