"""What all commands share: bad input is one line on stderr and exit code 2. Nothing here waits for JAX."""

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

MOST_PATH = 1000  # characters; directories are made one within the other
AGAIN_S = 0.02  # until a signal that came at a bad moment comes again
MOST_NAME = 255  # bytes, of every usual file system
SECONDS_PER_LINE = 10.0  # between two lines of progress, where no terminal shows a bar
# Arguments of medjax.make and agents_of that only Python, or an option of its own, can fill.
NOT_NUMBERS = (
    *("name", "reward", "observation", "following", "coupling"),
    *("credit", "central", "build"),
)


class OneLineParser(argparse.ArgumentParser):
    """An argument parser whose errors are one line on stderr and exit code 2; options are not abbreviated."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **options})

    def error(self, message: str) -> NoReturn:
        """Ends the command."""
        sys.exit(fail(self.prog, message))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse's, but for `--option=--`, which it takes for an empty list."""
        given = sys.argv[1:] if args is None else list(args)
        for word in given:
            if word.startswith("--") and word.partition("=")[2] == "--":
                self.error(f"argument {word.partition('=')[0]}: expected one argument")
        return super().parse_known_args(given, namespace)


class TerminatedError(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does."""


def signal_of(error: KeyboardInterrupt) -> int:
    """The number of the signal."""
    return int(signal.SIGTERM if isinstance(error, TerminatedError) else signal.SIGINT)


def _forgets(frame: FrameType) -> bool:
    """Whether it is a callback of the garbage collector or of a weak reference, a finaliser, or loads an extension."""
    collecting = (getattr(callback, "__code__", None) for callback in gc.callbacks)
    within_weak = frame.f_globals.get("__name__") in ("weakref", "_weakrefset")
    loading = frame.f_code.co_qualname.startswith("ExtensionFileLoader.")
    return within_weak or loading or frame.f_code.co_name == "__del__" or frame.f_code in collecting


def interrupt(number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT and SIGTERM: raises KeyboardInterrupt or TerminatedError in the code under way.

    Not where Python prints and forgets what is raised, as in the callback of the garbage collector that JAX has, which
    runs all the time while it traces, nor where an extension makes an ImportError of it. The signal comes again soon.
    """
    within = frame
    while within is not None:
        if _forgets(within):
            again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), number))
            again.daemon = True
            again.start()
            return
        within = within.f_back
    raise TerminatedError if number == signal.SIGTERM else KeyboardInterrupt


def command(main: Callable[[Sequence[str] | None], int]) -> Callable[..., int]:
    """`main` of a command, which Ctrl-C or SIGTERM end in one line and with exit code 128 + signal.

    A reader of its output that goes away ends nothing.
    """

    @functools.wraps(main)
    def heeding(argv: Sequence[str] | None = None) -> int:
        """As `main`."""
        # Said before JAX is imported: XLA's C++ says of slow programs that one should file a bug. It has no flag for
        # that line alone (openxla/xla#9828, jax-ml/jax#26098), and prints it as an error; real ones are raised.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        heard = threading.current_thread() is threading.main_thread()
        before = {signal.SIGTERM: signal.getsignal(signal.SIGTERM)} if heard else {}
        if heard and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            before[signal.SIGINT] = signal.default_int_handler
        for number in before:
            signal.signal(number, interrupt)
        try:
            with unbroken_output():
                return _heeding(main, argv)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    return heeding


def _heeding(main: Callable[[Sequence[str] | None], int], argv: Sequence[str] | None) -> int:
    try:
        return main(argv)
    except KeyboardInterrupt as error:
        print("interrupted", file=sys.stderr)
        return 128 + signal_of(error)


def leave(code: int) -> NoReturn:
    """Ends the process; at once after a signal, whatever its threads are compiling."""
    if code > 128:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def fail(prog: str, message: object) -> int:
    """Prints a one-line error and returns the exit code 2."""
    print(f"{prog}: {one_line(str(message))}", file=sys.stderr)
    return 2


def in_words(seconds: float) -> str:
    """A time for people."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def time_left(seconds: float) -> str:
    """How long something takes yet, in words."""
    return f"{in_words(seconds)} left"


def cannot_write(prog: str, path: Path, error: OSError) -> int:
    """Says in one line why a file was not written; it is as it was before. Returns the exit code 1."""
    fail(prog, f"cannot write {path}: {error.strerror or error}")
    return 1


def add_set_option(group: Any, text: str) -> None:
    """The option `--set NAME=VALUE`, which fills `overrides` with text."""
    group.add_argument(
        "--set", dest="overrides", metavar="NAME=VALUE", action="append", default=[], help=text
    )


def parse_overrides(assignments: Sequence[str]) -> dict[str, Any]:
    """`NAME=VALUE` texts as arguments of `medjax.make`; lists become tuples.

    Raises:
      InputError: a text without `=` or with a name that cannot be set from here.
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
    """The value in `NAME=VALUE`: JSON, a number as Python writes it (`1.`, `inf`, `nan`), or else the text.

    Raises:
      InputError: a name is given twice.
    """
    try:
        return read_json(text)
    except InputError:
        raise
    except (ValueError, RecursionError):
        pass
    try:
        return float(text) if text.isascii() else text  # Python takes the digits of every script
    except ValueError:
        return text


def read_json(text: str) -> Any:
    """A JSON value; raises InputError where a name is given twice, else ValueError, or RecursionError for its depth."""
    return json.loads(text, object_pairs_hook=named_once)


def named_once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """The pairs as a dict; raises InputError where a name is given twice."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"{shown(name)} is there twice, allowed: once")
        found[name] = value
    return found


def read_object(what: str, text: str) -> Any:
    """What `module:name` names, imported, from the current directory too.

    Args:
      what: it is for, in messages.
      text: `module:name`; the name may have dots.

    Raises:
      InputError: it is not of that form, there is no such module or name, or its module fails.
    """
    module, colon, name = text.partition(":")
    words = [*module.split("."), *name.split(".")]
    if not colon or not all(word.isidentifier() for word in words):
        raise InputError(f"{what} {shown(text)}: allowed module:name")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found: Any = importlib.import_module(module)
    except Exception as error:  # whatever somebody's module raises
        raise InputError(f"{what} {shown(text)}: {told(error)}") from error
    for word in name.split("."):
        found = getattr(found, word, None)
    if not callable(found):
        raise InputError(f"{what} {shown(text)}: {module} has no function of that name")
    return found


def whole_number(name: str, text: str, least: int = 0, most: int = 2**32 - 1) -> int:
    """The number that an option gives, by default one that a random seed can be; raises InputError if it is none."""
    number = int(text) if re.fullmatch("[0-9]{1,18}", text) else -1
    if not least <= number <= most:
        raise InputError(f"{name} {shown(text)}: allowed a whole number from {least} to {most}")
    return number


def as_path(name: str, given: str | os.PathLike[str]) -> Path:
    """The path that an option or an argument gives.

    Raises:
      InputError: it is none, no system takes it, or it could not be printed.
    """
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    said = f"{name} {shown(given)}: allowed"
    if not isinstance(text, str) or not text or not text.isprintable() or len(text) > MOST_PATH:
        raise InputError(f"{said} a path of 1 to {MOST_PATH} printable characters")
    if any(len(os.fsencode(part)) > MOST_NAME for part in text.split("/")):
        raise InputError(f"{said} names of at most {MOST_NAME} bytes")
    if text.startswith("~"):  # a shell would have replaced it
        raise InputError(f"{said} the path itself, or ./~")
    return Path(text)
