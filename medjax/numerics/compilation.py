"""Compiled programs: where they are kept, and what is said while one is compiled."""

import os
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

import jax

from medjax.numerics.devices import prepare_cpu

Result = TypeVar("Result")

POLL_S = 0.002  # between two looks at whether arrays are there
SILENT_S = 2.0  # compiling is spoken of if it takes longer
BEGINS = "/jax/compilation_cache/compile_requests_use_cache"
ENDS = "/jax/core/compile/backend_compile_duration"


def prepare_jax(messages: bool = True) -> None:
    """Makes JAX ready for programs of one's own as the commands have it; to be called before anything is computed.

    A device a core (`medjax.wrappers.prepare_cpu`), and compiled programs kept in the user's cache directory.

    Args:
      messages: a line on stderr while a program is compiled for longer than two seconds, and one when it is.
    """
    prepare_cpu()
    enable_compilation_cache()
    if messages:
        _Messages.hear()


def enable_compilation_cache() -> None:
    """Keeps compiled programs in the user's cache directory, unless the user chose another place."""
    chosen = getattr(jax.config, "jax_compilation_cache_dir", None)
    if chosen or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(root) / "medjax" / "xla"))


def compiled(lowered: Any, **options: Any) -> Any:
    """What `lowered.compile(**options)` gives, from a thread of its own: Python hears signals meanwhile."""
    future: Future[Any] = Future()

    def work() -> None:
        """Compiles."""
        try:
            future.set_result(lowered.compile(**options))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return future.result()


def computed(tree: Result) -> Result:
    """The same arrays, once they are there; Python hears signals meanwhile, as it does not in `device_get`."""
    for leaf in jax.tree.leaves(tree):
        while not leaf.is_ready():
            time.sleep(POLL_S)
    return tree


class _Messages:
    """What is said of compiling, by JAX's own events; a program that is read from the cache is none."""

    heard = False
    timers: dict[int, threading.Timer] = {}  # noqa: RUF012, one for each thread that compiles

    @classmethod
    def hear(cls) -> None:
        """Begins to listen, once."""
        if not cls.heard:
            cls.heard = True
            jax.monitoring.register_event_listener(cls.begins)
            jax.monitoring.register_event_duration_secs_listener(cls.ends)

    @classmethod
    def begins(cls, event: str, **_: object) -> None:
        """A program is about to be compiled in this thread."""
        if event == BEGINS:
            timer = threading.Timer(SILENT_S, say, ["compiling ..."])
            timer.daemon = True
            cls.timers[threading.get_ident()] = timer
            timer.start()

    @classmethod
    def ends(cls, event: str, duration_secs: float, **about: object) -> None:
        """It is."""
        if event == ENDS and (timer := cls.timers.pop(threading.get_ident(), None)):
            timer.cancel()
            if duration_secs > SILENT_S:
                say(f"compiled {about.get('fun_name', 'a program')} in {duration_secs:.0f} s")


def say(line: str) -> None:
    """A line on stderr."""
    print(line, file=sys.stderr, flush=True)
