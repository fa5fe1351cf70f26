"""Files that appear whole or not at all, and whether they can."""

import contextlib
import json
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from medjax.errors import InputError

UNFINISHED = ".partial"  # in the name of a file that is being written


def check_writable(directory: Path) -> None:
    """Tries to write in an existing directory; raises OSError where that fails."""
    with tempfile.TemporaryFile(dir=directory):
        pass


def check_input(name: str, path: Path) -> None:
    """Refuses (InputError) to read what is there and no file: it may have no end, or wait until somebody writes."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{name} {path}: is no file; allowed a file")
    except OSError as error:
        raise InputError(
            f"{name} {path}: {error.strerror}; allowed a file that can be read"
        ) from None


def check_output(name: str, path: Path) -> None:
    """Tries that a file can be written to `path` for the option `name`, before anything is computed for it.

    Raises:
      InputError: it cannot, or its directory is not there.
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
    """A new file beside `path` to write to; it takes its place at the end, and is removed if the writing fails.

    Its name cannot be foreseen, and nothing that is there is opened: no link is written through.
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
    """Removes what `replacing` left in a directory when its process was killed; nobody else may be writing there."""
    for leftover in directory.glob(f"*.{'[0-9a-f]' * 16}{UNFINISHED}*"):
        leftover.unlink()


def write_text(path: Path, text: str) -> None:
    """Writes text in full or not at all."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any) -> None:
    """Writes JSON in full or not at all; the parent directory is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")
