"""What the commands of medjax share: bad input is one line on stderr and exit code 2.

`train.cli` has the like of it for the learner's commands: it must not wait for JAX, which `import medjax` loads.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from medjax.wording import MOST_SHOWN, one_line, shown

MOST_PATH = 1000  # characters
MOST_NAME = 255  # bytes, of every usual file system
NOT_NUMBERS = (
    "name",
    "reward",
    "observation",
)  # arguments of medjax.make that only Python can fill


class InputError(ValueError):
    """Bad input; the message is one line that names what, the value and what is allowed."""


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line on stderr and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Ends the command."""
        self.exit(2, f"{self.prog}: {one_line(message)}\n")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse's, but for `--option=--`, which it takes for an empty list."""
        given = sys.argv[1:] if args is None else list(args)
        for word in given:
            if word.startswith("--") and word.partition("=")[2] == "--":
                self.error(f"argument {word.partition('=')[0]}: expected one argument")
        return super().parse_known_args(given, namespace)


def parse_overrides(assignments: Sequence[str]) -> dict[str, Any]:
    """`NAME=VALUE` texts as arguments of `medjax.make`; values are JSON, numbers that JSON does not write, or text.

    Raises:
      InputError: a text without `=` or with a name that cannot be set from here.
    """
    overrides: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or name in NOT_NUMBERS:
            raise InputError(
                f"--set {one_line(text, MOST_SHOWN)}: allowed NAME=VALUE with the name of a number of the environment"
            )
        overrides[name] = _value(value)
    return overrides


def _value(text: str) -> Any:
    for read in (json.loads, float):
        try:
            return read(text) if text.isascii() else text  # Python takes the digits of every script
        except (ValueError, RecursionError):
            continue
    return text


def whole_number(name: str, text: str) -> int:
    """A number that a random seed can be.

    Raises:
      InputError: it is none.
    """
    number = int(text) if re.fullmatch("[0-9]{1,18}", text) else -1
    if not 0 <= number < 2**32:
        raise InputError(f"--{name} {shown(text)}: allowed a whole number from 0 to {2**32 - 1}")
    return number


def as_path(name: str, text: str) -> Path:
    """The path that an option names.

    Raises:
      InputError: no system takes it, or it could not be printed.
    """
    if not text or not text.isprintable() or len(text) > MOST_PATH:
        raise InputError(
            f"--{name} {shown(text)}: allowed a path of 1 to {MOST_PATH} printable characters"
        )
    if any(len(os.fsencode(part)) > MOST_NAME for part in text.split("/")):
        raise InputError(f"--{name} {shown(text)}: allowed names of at most {MOST_NAME} bytes")
    if text.startswith("~"):  # a shell would have replaced it
        raise InputError(f"--{name} {shown(text)}: allowed the path itself, or ./~")
    return Path(text)


def check_writable(out: Path) -> None:
    """Tries that a file can be written there, before anything is computed for it.

    Raises:
      InputError: it cannot.
    """
    try:
        if out.exists() and not out.is_file():
            what = "a directory" if out.is_dir() else "a device"
            raise InputError(f"--out {out}: is {what}; allowed a file")
        with tempfile.TemporaryFile(dir=out.parent):
            pass
    except OSError as error:
        raise InputError(
            f"--out {out}: {error.strerror}; allowed a file in a directory that can be written"
        ) from None
