"""Files that appear whole or not at all, and whether they can."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from medjax.errors import InputError


def check_writable(directory: Path) -> None:
    """Tries to write in an existing directory; raises OSError where that fails."""
    with tempfile.TemporaryFile(dir=directory):
        pass


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
    """A path beside `path` to write to; it takes its place at the end, and is removed if the writing fails."""
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
