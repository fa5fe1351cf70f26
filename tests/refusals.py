"""What a refusal of bad input must look like."""

import reprlib
import time
import warnings

import pytest

from medjax.errors import InputError

MOST_S = 2.0  # processor time
MOST_CHARACTERS = 400  # of a message: the value, the name and what is allowed


class AcceptedError(BaseException):
    """Bad input was accepted: it reached the first program."""


def check_line(line, *words):
    """Asserts that a line is short and printable and contains the words."""
    assert line.isprintable(), ascii(line)
    assert len(line) <= MOST_CHARACTERS, len(line)
    for word in words:
        assert word in line, line


def refused(call, *words):
    """Asserts that the call raises an InputError at once, without a warning; returns its message."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=r"allowed|did you mean") as error:
            call()
    assert time.process_time() - start < MOST_S
    assert type(error.value) is InputError
    check_line(str(error.value), *words)
    return str(error.value)


def not_refused(calls, *words):
    """Describes each pair of a value and a call with it that fails `refused`."""
    wrong = []
    for value, call in calls:
        try:
            refused(call, *words)
        except (AcceptedError, pytest.fail.Exception, AssertionError, Exception) as error:
            kind = type(error).__name__
            wrong.append(f"{type(value).__name__} {ascii_of(value)}: {kind} {str(error)[:200]}")
    return wrong


def ascii_of(value):
    try:
        return ascii(reprlib.repr(value))[:60]  # a value may hold more than memory does
    except Exception:
        return "?"
