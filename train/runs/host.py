"""The process around a run: signals, and the cache of compiled programs."""

import contextlib
import dataclasses
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax


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


def enable_compilation_cache() -> None:
    """Keeps compiled programs in the user's cache directory, unless the user chose another place."""
    if (
        getattr(jax.config, "jax_compilation_cache_dir", None)
        or "JAX_COMPILATION_CACHE_DIR" in os.environ
    ):
        return
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(root) / "medjax" / "xla"))
