"""What a refusal of bad input has to look like."""

import reprlib
import time
import warnings

import pytest

from medjax.errors import InputError

MOST_S = 2.0  # of the processor: nothing here waits
MOST_CHARACTERS = 400  # of a message: the value, the name and what is allowed


class AcceptedError(BaseException):
    """Bad input got as far as the first program."""


def check_line(line, *words):
    """One short line that a terminal can show and that has the words."""
    assert line.isprintable(), ascii(line)
    assert len(line) <= MOST_CHARACTERS, len(line)
    for word in words:
        assert word in line, line


def refused(call, *words):
    """The message of the InputError that a call ends with, at once and without a warning."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=r"allowed|did you mean") as error:
            call()
    assert time.process_time() - start < MOST_S
    assert type(error.value) is InputError
    check_line(str(error.value), *words)


def not_refused(calls, *words):
    """Of pairs of a value and a call with it, those that did not end as `refused` wants it, a line each."""
    wrong = []
    for value, call in calls:
        try:
            refused(call, *words)
        except (AcceptedError, pytest.fail.Exception, AssertionError, Exception) as error:
            kind = type(error).__name__
            wrong.append(f"{type(value).__name__} {ascii_of(value)}: {kind} {str(error)[:200]}")
    return wrong


def ascii_of(value):
    """A value for a message, whatever it is."""
    try:
        return ascii(reprlib.repr(value))[:60]  # a value may hold more than memory does
    except Exception:
        return "?"
