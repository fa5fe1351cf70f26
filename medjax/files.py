"""Atomic file writes, and checks of input and output paths."""

import contextlib
import json
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from medjax.errors import InputError

UNFINISHED = ".partial"  # part of the name of an unfinished file


def check_writable(directory: Path) -> None:
    """Raises OSError unless the existing directory is writable."""
    with tempfile.TemporaryFile(dir=directory):
        pass


def check_input(name: str, path: Path) -> None:
    """Raises InputError if path exists but is not a regular file: a device may never end, a pipe may block."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{name} {path} is not a file; allowed a file")
    except OSError as error:
        raise InputError(
            f"{name} {path}: {error.strerror}; allowed a file that can be read"
        ) from None


def check_output(name: str, path: Path) -> None:
    """Checks that the option `name` can write a file to `path`, before any computation.

    Raises:
      InputError: path is not writable, or its directory does not exist.
    """
    try:
        if path.exists() and not path.is_file():
            what = "a directory" if path.is_dir() else "a device"
            raise InputError(f"{name} {path}: is {what}; allowed a file")
        check_writable(path.parent)
    except OSError as error:
        allowed = "allowed a file in a directory that can be written"
        raise InputError(f"{name} {path}: {error.strerror}; {allowed}") from None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a new file beside `path`; it replaces `path` at the end, or is removed if writing fails.

    Its name is random and the file must not exist yet, so that nobody can plant a link to write through.
    """
    name = f"{path.stem[:40]}.{secrets.token_hex(8)}{UNFINISHED}{path.suffix}"
    partial = path.with_name(name)
    os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def remove_unfinished(directory: Path) -> None:
    """Removes leftovers of a killed process's `replacing` from a directory to which nobody else is writing."""
    for leftover in directory.glob(f"*.{'[0-9a-f]' * 16}{UNFINISHED}*"):
        leftover.unlink()


def write_text(path: Path, text: str) -> None:
    """Writes text atomically."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any) -> None:
    """Writes JSON atomically; creates the parent directory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")
