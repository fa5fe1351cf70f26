"""What the benchmarks' command lines share: bad input is one line on stderr and exit code 2."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import medjax
from medjax import commandline
from medjax.commandline import OneLineParser, as_path
from medjax.errors import InputError, shown
from medjax.files import check_output

T = TypeVar("T")


def benchmark_parser(name: str, description: str | None) -> OneLineParser:
    """The parser of `python -m benchmarks.NAME`, with `--json FILE`."""
    parser = OneLineParser(
        prog=f"python -m benchmarks.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--json", type=output_file, metavar="FILE", help="write the figures here too"
    )
    return parser


def argument(read: Callable[[str, str], T]) -> Callable[[str], T]:
    """`read(name, text)` as a type of argument: argparse names the option, and shows only its own error's words."""

    def parse(text: str) -> T:
        try:
            return read("value", text)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def whole_number(least: int = 1, most: int = 10**7) -> Callable[[str], int]:
    """A type of argument: whole numbers from `least` to `most`."""
    return argument(partial(commandline.whole_number, least=least, most=most))


positive = whole_number()
a_seed = whole_number(least=0, most=2**32 - 1)


def add_scenario(parser: OneLineParser) -> None:
    """Adds `--scenario NAME`."""
    parser.add_argument("--scenario", default="paper", choices=list(medjax.SCENARIOS))


def episodes_parser(name: str, description: str | None, episodes: int, seed: int) -> OneLineParser:
    """`benchmark_parser` of a command that plays whole episodes, with these defaults."""
    parser = benchmark_parser(name, description)
    parser.add_argument(
        "--episodes", type=whole_number(least=2), default=episodes, help="of each policy"
    )
    parser.add_argument("--seed", type=a_seed, default=seed, help="which episodes")
    add_scenario(parser)
    return parser


a_path = argument(as_path)


@argument
def output_file(name: str, text: str) -> Path:
    """A type of argument: a file that can be written, checked before anything is measured."""
    path = as_path(name, text)
    check_output(name, path)
    return path


def picture(text: str) -> Path:
    """A type of argument: a PNG file that can be written."""
    if not text.endswith(".png"):
        raise argparse.ArgumentTypeError(f"{shown(text)}: allowed a name that ends in .png")
    return output_file(text)
