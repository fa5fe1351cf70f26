"""What the benchmarks' command lines share: bad input is one line on stderr and exit code 2."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import medjax
from train.cli import OneLineParser, as_path
from train.config import SettingError
from train.rundir import check_output
from train.wording import shown


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


def whole_number(least: int = 1, most: int = 10**7) -> Callable[[str], int]:
    """A type of argument: whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        number = int(text) if re.fullmatch("[0-9]{1,18}", text) else -1
        if not least <= number <= most:
            allowed = f"a whole number from {least} to {most}"
            raise argparse.ArgumentTypeError(f"{shown(text)}: allowed {allowed}")
        return number

    return parse


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


def a_path(text: str) -> Path:
    """A type of argument: a path, there or not."""
    try:
        return as_path("it", text)
    except SettingError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def picture(text: str) -> Path:
    """A type of argument: a PNG file that can be written."""
    if not text.endswith(".png"):
        raise argparse.ArgumentTypeError(f"{shown(text)}: allowed a name that ends in .png")
    return output_file(text)


def output_file(text: str) -> Path:
    """A type of argument: a file that can be written, checked before anything is measured."""
    try:
        check_output("it", target := a_path(text))
    except SettingError:
        allowed = "allowed a file in a directory that exists and is writable"
        raise argparse.ArgumentTypeError(f"{shown(text)}: {allowed}") from None
    return target
