"""How messages show what was given: on one line, printable, and not longer than a reader wants it."""

import re
import reprlib

MOST_SHOWN = 100  # characters of a value in a message
MOST_SAID = 600  # characters of a message on the command line


class MissingLibrary(ImportError):
    """An optional library is not installed; the message says which, and the command that installs it."""

    def __init__(self, library: str) -> None:
        super().__init__(f'{library} is not installed: pip install -e ".[render]"')


class InputError(ValueError):
    """Bad input; the message is one line that names what, the value and what is allowed.

    A name of a file may hold line ends, or what no terminal shows: these are told, whoever words the message.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


_SHORT = reprlib.Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = MOST_SHOWN


def printable(text: str) -> str:
    """Text on one line, where characters that cannot be printed are told by their numbers."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))


def one_line(text: str, most: int = MOST_SAID) -> str:
    """Text as one line of printable characters; words and lines that are too long end in dots."""
    line = printable(" ".join(text.split())[: most + 1])
    line = re.sub(rf"\S{{{MOST_SHOWN + 1},}}", lambda word: _cut(word[0], MOST_SHOWN), line)
    return _cut(line, most)


def shown(value: object) -> str:
    """What a value is, in a message that refuses it."""
    try:
        text = _SHORT.repr(value)
    except Exception:  # whatever a stranger's __repr__ raises; whole numbers of 4300 digits do
        text = f"something of type {type(value).__name__}"
    return one_line(text, MOST_SHOWN)


def told(error: Exception) -> str:
    """What somebody's own code raised, in a message that refuses it."""
    return one_line(f"{type(error).__name__}: {error}", MOST_SHOWN)


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."
