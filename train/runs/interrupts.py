"""Signals that ask a run to stop, and the error of a run that stopped early."""

import contextlib
import dataclasses
import math
import os
import signal
import threading
from collections.abc import Iterator
from typing import Any


class StoppedError(RuntimeError):
    """A run stopped before it was done; the message says why, and what was saved.

    Attributes:
        code: exit code of the command: 1, or 128 + signal.
        alone: the run's other processes do not know that this one stopped.
    """

    def __init__(self, code: int, why: str, alone: bool = True) -> None:
        super().__init__(why)
        self.code, self.alone = code, alone


PATIENCE_S = 3.0  # a longer wait after a signal is announced to the user


@dataclasses.dataclass
class Interrupt:
    """The signal that asked the run to stop."""

    number: int | None = None  # None: there was no signal
    busy_s: float = 0.0  # duration of the call under way; inf: not known yet


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """A context in which the first SIGINT or SIGTERM is only recorded; a second one ends the process as usual.

    Python handles signals only in its main thread; in other threads this does nothing.
    """
    noted = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    previous: dict[int, Any] = {}

    def note(number: int, frame: Any) -> None:
        """Records the signal, says so if the call under way is long, and lets the next signal end the process."""
        noted.number = number
        if noted.busy_s > PATIENCE_S:
            about = f", of about {noted.busy_s:.0f} s" if math.isfinite(noted.busy_s) else ""
            soon = f"stopping after this update{about}; again to stop at once\n"
            os.write(2, soon.encode())  # print() may be what was interrupted
        for each, handler in previous.items():
            signal.signal(each, handler)

    try:
        for each in (int(signal.SIGINT), int(signal.SIGTERM)):
            previous[each] = signal.signal(each, note)
        yield noted
    finally:
        for each, handler in previous.items():
            signal.signal(each, handler)
