"""Error types, formatting of values in messages (one line, printable and short), and former names of members."""

import re
import reprlib
import sys
import warnings
from collections.abc import Callable
from typing import Any

MOST_SHOWN = 100  # characters of a value in a message
MOST_SAID = 600  # characters of a message on the command line


class MissingLibrary(ImportError):
    """An optional library is missing; the message names it and the command that installs it."""

    def __init__(self, library: str) -> None:
        super().__init__(f'{library} is not installed: pip install -e ".[render]"')


class InputError(ValueError):
    """Bad input; the message is one line that names the input, its value and what is allowed.

    Characters that do not print, as in a file name, are escaped.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


_SHORT = reprlib.Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = MOST_SHOWN


def printable(text: str) -> str:
    """Joins text to one line and escapes characters that do not print."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))


def one_line(text: str, most: int = MOST_SAID) -> str:
    """Text as one line of printable characters; overlong words and lines end in dots."""
    line = printable(" ".join(text.split())[: most + 1])
    line = re.sub(rf"\S{{{MOST_SHOWN + 1},}}", lambda word: _cut(word[0], MOST_SHOWN), line)
    return _cut(line, most)


def shown(value: object) -> str:
    """Formats a rejected value for a message."""
    try:
        text = _SHORT.repr(value)
    except Exception:  # from a user's __repr__; integers of more than 4300 digits raise, too
        text = f"something of type {type(value).__name__}"
    return one_line(text, MOST_SHOWN)


def told(error: Exception) -> str:
    """Formats an exception from user code for a message."""
    return one_line(f"{type(error).__name__}: {error}", MOST_SHOWN)


def renamed(old: str, new: str, value: Any, stacklevel: int = 3) -> Any:
    """Returns the value of a member that has a new name; the caller's caller is warned that it used the former one."""
    text = f"{old} is now {new}; the old name goes with the next version"
    warnings.warn(text, DeprecationWarning, stacklevel)
    return value


def former_names(module: str, **names: str) -> Callable[[str], Any]:
    """A `__getattr__` for a module, by which former names of its members go on working; `names` maps old to new."""

    def get(name: str) -> Any:
        """The member that has a new name; AttributeError if there is none."""
        if name in names:
            value = getattr(sys.modules[module], names[name])
            return renamed(f"{module}.{name}", names[name], value)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return get


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."
