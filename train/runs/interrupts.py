"""Signals that ask a run to end."""

import contextlib
import dataclasses
import signal
from collections.abc import Iterator
from typing import Any


@dataclasses.dataclass
class Interrupt:
    """The signal that asked to end; None while there is none."""

    number: int | None = None


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Within it SIGINT and SIGTERM only leave a note; a second one ends the process as usual."""
    noted = Interrupt()
    previous: dict[int, Any] = {}

    def note(number: int, frame: Any) -> None:
        noted.number = number
        for each, handler in previous.items():
            signal.signal(each, handler)

    try:
        for each in (int(signal.SIGINT), int(signal.SIGTERM)):
            previous[each] = signal.signal(each, note)
        yield noted
    finally:
        for each, handler in previous.items():
            signal.signal(each, handler)
