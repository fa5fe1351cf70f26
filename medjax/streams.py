"""What a command prints to, when whoever reads it may go away."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Unbroken:
    """A stream whose reader may go away, as `head` does: the work goes on, and what is still said goes nowhere."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """As the stream's."""
        try:
            return int(self._stream.write(text))
        except BrokenPipeError:
            self._lose()
            return len(text)

    def flush(self) -> None:
        """As the stream's."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._lose()

    def _lose(self) -> None:
        """Points the stream's descriptor nowhere, so that what is left in buffers can be written, too."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


@contextlib.contextmanager
def unbroken_output() -> Iterator[None]:
    """Within it, what is printed may find no reader; a stream that is closed from the first stays None."""
    streams: tuple[Any, ...] = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (stream and _Unbroken(stream) for stream in streams)
    try:
        yield
    finally:
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        sys.stdout, sys.stderr = streams
