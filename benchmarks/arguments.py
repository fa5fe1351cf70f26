"""What the benchmarks' command lines share: bad input is one line on stderr and exit code 2."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import medjax
from train.cli import OneLineParser
from train.rundir import check_writable


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


def add_scenario(parser: OneLineParser) -> None:
    """Adds `--scenario NAME`."""
    parser.add_argument("--scenario", default="paper", choices=list(medjax.SCENARIOS))


def episodes_parser(name: str, description: str | None, episodes: int, seed: int) -> OneLineParser:
    """`benchmark_parser` of a command that plays whole episodes, with these defaults."""
    parser = benchmark_parser(name, description)
    parser.add_argument(
        "--episodes", type=whole_number(least=2), default=episodes, help="of each policy"
    )
    parser.add_argument("--seed", type=whole_number(least=0), default=seed, help="which episodes")
    add_scenario(parser)
    return parser


def picture(text: str) -> Path:
    """A type of argument: a PNG file that can be written."""
    if not text.endswith(".png"):
        raise argparse.ArgumentTypeError(f"{text!r}: allowed a name that ends in .png")
    return output_file(text)


def output_file(text: str) -> Path:
    """A type of argument: a file that can be written, checked before anything is measured."""
    path = Path(text)
    refusal = f"{text!r}: allowed a file in a directory that exists and is writable"
    if path.is_dir():
        raise argparse.ArgumentTypeError(refusal)
    try:
        check_writable(path.parent)
    except OSError:
        raise argparse.ArgumentTypeError(refusal) from None
    return path
