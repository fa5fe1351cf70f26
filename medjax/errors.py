"""Error types, and formatting of values in messages: one line, printable and short."""

import re
import reprlib

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


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."
