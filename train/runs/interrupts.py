"""Signals that ask a run to end, and how one ends before it is done."""

import contextlib
import dataclasses
import os
import signal
import threading
from collections.abc import Iterator
from typing import Any


class StoppedError(RuntimeError):
    """A run that ended before it was done; the message says why, and what is left.

    Attributes:
        code: exit code of the command: 1, or 128 + signal.
        alone: other processes of the run do not know.
    """

    def __init__(self, code: int, why: str, alone: bool = True) -> None:
        super().__init__(why)
        self.code, self.alone = code, alone


PATIENCE_S = 3.0  # of whoever wants to stop, without a word


@dataclasses.dataclass
class Interrupt:
    """The signal that asked to end; None while there is none."""

    number: int | None = None
    busy_s: float = 0.0  # how long what is under way takes


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Within it SIGINT and SIGTERM only leave a note; a second one ends the process as usual.

    Python hears signals in its main thread alone: in another, nothing changes.
    """
    noted = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    previous: dict[int, Any] = {}

    def note(number: int, frame: Any) -> None:
        noted.number = number
        if noted.busy_s > PATIENCE_S:
            soon = f"stopping after this update, of about {noted.busy_s:.0f} s; again to stop at once\n"
            os.write(2, soon.encode())  # not print, which may be what was interrupted
        for each, handler in previous.items():
            signal.signal(each, handler)

    try:
        for each in (int(signal.SIGINT), int(signal.SIGTERM)):
            previous[each] = signal.signal(each, note)
        yield noted
    finally:
        for each, handler in previous.items():
            signal.signal(each, handler)
