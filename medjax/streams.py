"""Output streams that survive the loss of their reader."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Unbroken:
    """A stream whose reader may go away, as `head` does; further output is then discarded."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Writes text; discards it if the reader is gone."""
        try:
            return int(self._stream.write(text))
        except BrokenPipeError:
            self._lose()
            return len(text)

    def flush(self) -> None:
        """Flushes; discards the buffer if the reader is gone."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._lose()

    def _lose(self) -> None:
        """Redirects the descriptor to the null device, so that buffered text can be written without error."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


def shows_bars() -> bool:
    """Whether stderr is a terminal, where a progress bar can move."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextlib.contextmanager
def unbroken_output() -> Iterator[None]:
    """Context in which printing survives the loss of its reader.

    Output to a stream that was closed from the start, which Python shows as None, is discarded: libraries such as tqdm
    write to both streams unasked.
    """
    streams: tuple[Any, ...] = sys.stdout, sys.stderr
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        sys.stdout, sys.stderr = (_Unbroken(stream or nowhere) for stream in streams)
        try:
            yield
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            sys.stdout, sys.stderr = streams
