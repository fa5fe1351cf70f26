"""Shared code of the benchmark commands: options, error handling and output."""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import jax

import medjax
from medjax import commandline
from medjax.commandline import OneLineParser, as_path, cannot_write
from medjax.errors import InputError, shown
from medjax.files import check_output, write_text
from medjax.numerics.devices import prepare_cpu
from train.evaluation.statistics import plain

T = TypeVar("T")

# Where Python finds `-m train.ppo`, whatever the working directory is.
ROOT = Path(__file__).resolve().parents[1]


def benchmark_parser(name: str, description: str | None) -> OneLineParser:
    """Parser of `python -m benchmarks.NAME` with `--json FILE`."""
    parser = OneLineParser(
        prog=f"python -m benchmarks.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    figures = "also write the figures to this file"
    parser.add_argument("--json", type=output_file, metavar="FILE", help=figures)
    return parser


def run_command(
    parser: OneLineParser,
    measure: Callable[[argparse.Namespace], Any],
    arguments: list[str] | None = None,
    plot: Callable[[Path, Any], None] | None = None,
) -> Any:
    """Runs a command and returns the result of `measure`.

    Bad input ends the process with one line and exit code 2, a signal with one line and 128 + signal.

    Args:
      parser: of `benchmark_parser`.
      measure: measures, prints, and returns what `--json` writes; its InputError is bad input.
      arguments: None uses those of the process.
      plot: draws the result to the PNG of `--plot`.
    """
    results = []

    @commandline.command
    def run(argv: Sequence[str] | None) -> int:
        """Runs the command and leaves what it measured in `results`."""
        options = parser.parse_args(argv)
        prepare_cpu()
        try:
            results.append(measure(options))
        except InputError as error:
            parser.error(str(error))
        if options.json:
            text = json.dumps(without_nan(results[0]), indent=2, allow_nan=False) + "\n"
            write(parser.prog, options.json, lambda path: write_text(path, text))
        if plot and options.plot:
            write(parser.prog, options.plot, lambda path: plot(path, results[0]))
        return 0

    if code := run(arguments):
        commandline.leave(code)
    return results[0]


def without_nan(report: Any) -> Any:
    """A report with None in place of numbers that are not finite, because JSON has none of them."""
    if isinstance(report, Mapping):
        return {name: without_nan(value) for name, value in report.items()}
    if isinstance(report, list | tuple):
        return [*map(without_nan, report)]
    return plain(report) if isinstance(report, float) else report


def write(prog: str, path: Path, writing: Callable[[Path], None]) -> None:
    """Writes a file; on failure the process ends with one line and exit code 1."""
    try:
        writing(path)
    except OSError as error:
        sys.exit(cannot_write(prog, path, error))


def machine() -> dict[str, str]:
    """The backend, device and JAX version that a measured speed depends on."""
    return {
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "jax_version": jax.__version__,
    }


def say(line: str) -> None:
    """Prints progress to stderr."""
    print(line, file=sys.stderr, flush=True)


def argument(read: Callable[[str, str], T]) -> Callable[[str], T]:
    """Adapts `read(name, text)` to an argparse type, whose errors keep their message."""

    def parse(text: str) -> T:
        try:
            return read("value", text)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def whole_number(least: int = 1, most: int = 10**7) -> Callable[[str], int]:
    """An argparse type of whole numbers from `least` to `most`."""
    return argument(partial(commandline.whole_number, least=least, most=most))


positive = whole_number()
natural = whole_number(least=0)
a_seed = whole_number(least=0, most=2**32 - 1)


def a_number(allowed: str, is_allowed: Callable[[float], bool]) -> Callable[[str], float]:
    """An argparse type of finite numbers that `is_allowed` accepts; `allowed` describes them in the error."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (text.isascii() and math.isfinite(value) and is_allowed(value)):
            raise argparse.ArgumentTypeError(f"{shown(text)}: allowed {allowed}")
        return value

    return parse


non_negative = a_number("a number from 0", lambda value: value >= 0.0)


def add_number(
    parser: OneLineParser,
    option: str,
    default: Any,
    text: str,
    kind: Callable[[str], Any] = positive,
    nargs: str | None = None,
) -> None:
    """Adds an option of a number, by default a whole one from 1, or with `nargs="+"` of several."""
    shown = " ".join(f"{each:g}" for each in (default if nargs else [default]))
    text = f"{text} (default: {shown})"
    parser.add_argument(option, type=kind, default=default, nargs=nargs, metavar="N", help=text)


def add_scenario(parser: OneLineParser) -> None:
    """Adds `--scenario NAME`."""
    parser.add_argument(
        "--scenario",
        default="paper",
        choices=list(medjax.SCENARIOS),
        help="preset (default: paper)",
    )


def episodes_parser(
    name: str, description: str | None, episodes: int, seed: int, scenario: bool = True
) -> OneLineParser:
    """`benchmark_parser` with options of episodes, seed and scenario, for commands that play whole episodes."""
    parser = benchmark_parser(name, description)
    add_number(parser, "--episodes", episodes, "episodes per policy", whole_number(least=2))
    add_number(parser, "--seed", seed, "seed of the episodes", a_seed)
    if scenario:
        add_scenario(parser)
    return parser


a_path = argument(as_path)


@argument
def output_file(name: str, text: str) -> Path:
    """An argparse type of files that can be written, checked before anything is measured."""
    path = as_path(name, text)
    check_output(name, path)
    return path


def add_plot(parser: OneLineParser, what: str) -> None:
    """Adds `--plot FILE.png`."""
    parser.add_argument(
        "--plot", type=picture, metavar="FILE.png", help=f"draw {what} to this file"
    )


def picture(text: str) -> Path:
    """An argparse type of PNG files that can be written."""
    if not text.endswith(".png"):
        raise argparse.ArgumentTypeError(f"{shown(text)}: allowed a name that ends in .png")
    return output_file(text)
