"""Shared parts of all commands: bad input gives one line on stderr and exit code 2. Does not import JAX."""

import argparse
import functools
import gc
import importlib
import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from medjax.errors import MOST_SHOWN, InputError, one_line, shown, told
from medjax.streams import unbroken_output

MOST_PATH = 1000  # characters, which leaves room for nested directories
AGAIN_S = 0.02  # delay after which a deferred signal is sent again
MOST_NAME = 255  # bytes, the limit of common file systems
SECONDS_PER_LINE = 10.0  # between progress lines, if no terminal shows a bar
# Arguments of medjax.make and agents_of that `--set` cannot fill; they need Python or their own option.
NOT_NUMBERS = (
    *("name", "reward", "observation", "following", "coupling"),
    *("credit", "central", "build"),
)


class OneLineParser(argparse.ArgumentParser):
    """An argument parser with one-line errors and exit code 2; does not accept abbreviated options."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **options})

    def error(self, message: str) -> NoReturn:
        """Prints the error and exits with code 2."""
        sys.exit(fail(self.prog, message))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse, but rejects `--option=--`, which argparse parses as an empty list."""
        given = sys.argv[1:] if args is None else list(args)
        for word in given:
            if word.startswith("--") and word.partition("=")[2] == "--":
                self.error(f"argument {word.partition('=')[0]}: expected one argument")
        return super().parse_known_args(given, namespace)


class TerminatedError(KeyboardInterrupt):
    """Raised on SIGTERM, which ends a command as Ctrl-C does."""


def signal_of(error: KeyboardInterrupt) -> int:
    """Number of the signal behind an interrupt."""
    return int(signal.SIGTERM if isinstance(error, TerminatedError) else signal.SIGINT)


def _loses_exceptions(frame: FrameType) -> bool:
    """Whether Python loses what is raised in this frame: while it collects garbage or loads an extension."""
    collecting = (getattr(callback, "__code__", None) for callback in gc.callbacks)
    of_weak = frame.f_globals.get("__name__") in ("weakref", "_weakrefset")
    loading = frame.f_code.co_qualname.startswith("ExtensionFileLoader.")
    return of_weak or loading or frame.f_code.co_name == "__del__" or frame.f_code in collecting


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT and SIGTERM: raises KeyboardInterrupt or TerminatedError in the running code.

    Where that would be lost, such as in JAX's callback of the garbage collector, which runs often during tracing, the
    signal is sent again a moment later.
    """
    within = frame
    while within is not None:
        if _loses_exceptions(within):
            again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        within = within.f_back
    raise TerminatedError if number == signal.SIGTERM else KeyboardInterrupt


def command(main: Callable[[Sequence[str] | None], int]) -> Callable[..., int]:
    """Decorates the `main` of a command: Ctrl-C and SIGTERM print one line and give exit code 128 + signal.

    The command continues if the reader of its output goes away.
    """

    @functools.wraps(main)
    def run(argv: Sequence[str] | None = None) -> int:
        """Runs `main` with these handlers."""
        # XLA's C++ logs an error that asks to file a bug when compilation is slow, and has no flag for that line alone
        # (openxla/xla#9828, jax-ml/jax#26098). Real errors are raised anyway. Must precede the import of JAX.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        before = {}
        if threading.current_thread() is threading.main_thread():
            before[signal.SIGTERM] = signal.signal(signal.SIGTERM, interrupt)
            if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored
                before[signal.SIGINT] = signal.signal(signal.SIGINT, interrupt)
        with unbroken_output():
            try:
                return main(argv)
            except KeyboardInterrupt as error:
                print("interrupted", file=sys.stderr)
                return 128 + signal_of(error)
            finally:
                for number, handler in before.items():
                    signal.signal(number, handler)

    return run


def leave(code: int) -> NoReturn:
    """Exits the process; after a signal at once, even while threads are compiling."""
    if code > 128:
        leave_at_once(code)
    sys.exit(code)


def leave_at_once(code: int) -> NoReturn:
    """Exits the process without waiting for threads or other processes."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # None: closed from the start
        stream.flush()
    os._exit(code)


def fail(prog: str, message: object) -> int:
    """Prints a one-line error and returns the exit code 2."""
    print(f"{prog}: {one_line(str(message))}", file=sys.stderr)
    return 2


def in_words(seconds: float) -> str:
    """Formats a duration for people, such as `3 min`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def time_left(seconds: float) -> str:
    """Formats the remaining time, such as `3 min left`."""
    return f"{in_words(seconds)} left"


def cannot_write(prog: str, path: Path, error: OSError) -> int:
    """Prints in one line why a file was not written (an old one is unchanged); returns exit code 1."""
    fail(prog, f"cannot write {path}: {error.strerror or error}")
    return 1


def add_set_option(group: Any, text: str) -> None:
    """Adds the option `--set NAME=VALUE`, which collects texts in `overrides`."""
    group.add_argument(
        "--set", dest="overrides", metavar="NAME=VALUE", action="append", default=[], help=text
    )


def parse_overrides(assignments: Sequence[str]) -> dict[str, Any]:
    """Parses `NAME=VALUE` texts into arguments of `medjax.make`; lists become tuples.

    Raises:
      InputError: a text has no `=`, or its name cannot be set this way.
    """
    overrides: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or name in NOT_NUMBERS:
            allowed = "allowed NAME=VALUE with the name of a number of the environment"
            raise InputError(f"--set {one_line(text, MOST_SHOWN)}: {allowed}")
        read = read_value(value)
        overrides[name] = tuple(read) if isinstance(read, list) else read
    return overrides


def read_value(text: str) -> Any:
    """Parses a value as JSON or as a Python number (`1.`, `inf`, `nan`); otherwise returns the text.

    Raises:
      InputError: a JSON object repeats a name.
    """
    try:
        return read_json(text)
    except InputError:
        raise
    except (ValueError, RecursionError):
        pass
    try:
        return float(text) if text.isascii() else text  # `float` accepts digits of any script
    except ValueError:
        return text


def read_json(text: str) -> Any:
    """Parses JSON; raises InputError for repeated names, ValueError for bad JSON, RecursionError for deep nesting."""
    return json.loads(text, object_pairs_hook=named_once)


def named_once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Converts pairs to a dict; raises InputError if a name repeats."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"{shown(name)} is given twice: allowed once")
        found[name] = value
    return found


def read_object(what: str, text: str) -> Any:
    """Imports the callable that `module:name` names; also searches the current directory.

    Args:
      what: its purpose, for messages.
      text: `module:name`; the name may have dots.

    Raises:
      InputError: the form is wrong, the import fails, or the name is missing or not callable.
    """
    module, colon, name = text.partition(":")
    words = [*module.split("."), *name.split(".")]
    if not colon or not all(word.isidentifier() for word in words):
        raise InputError(f"{what} {shown(text)}: allowed module:name")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found: Any = importlib.import_module(module)
    except Exception as error:  # user modules may raise anything
        raise InputError(f"{what} {shown(text)}: {told(error)}") from error
    for word in name.split("."):
        found = getattr(found, word, None)
    if not callable(found):
        raise InputError(f"{what} {shown(text)}: {module} has no function of that name")
    return found


def whole_number(name: str, text: str, least: int = 0, most: int = 2**32 - 1) -> int:
    """Parses a whole number, by default in the range of a random seed; raises InputError otherwise."""
    number = int(text) if re.fullmatch("[0-9]{1,18}", text) else -1
    if not least <= number <= most:
        raise InputError(f"{name} {shown(text)}: allowed a whole number from {least} to {most}")
    return number


def as_path(name: str, given: str | os.PathLike[str]) -> Path:
    """Converts an option or argument to a path.

    Raises:
      InputError: given is not a path, is too long, is not printable, or starts with `~`.
    """
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    said = f"{name} {shown(given)}: allowed"
    if not isinstance(text, str) or not text or not text.isprintable() or len(text) > MOST_PATH:
        raise InputError(f"{said} a path of 1 to {MOST_PATH} printable characters")
    if any(len(os.fsencode(part)) > MOST_NAME for part in text.split("/")):
        raise InputError(f"{said} names of at most {MOST_NAME} bytes")
    if text.startswith("~"):  # a shell would have expanded it
        raise InputError(f"{said} the path itself, or ./~")
    return Path(text)
