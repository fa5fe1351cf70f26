"""Compiled programs: their cache, and messages while one is compiled."""

import functools
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

POLL_S = 0.002  # interval between checks whether arrays are ready
SILENT_S = 2.0  # a longer compilation is announced
BEGINS = "/jax/compilation_cache/compile_requests_use_cache"
ENDS = "/jax/core/compile/backend_compile_duration"
_timers: dict[int, threading.Timer] = {}  # one for each thread that compiles


def prepare_jax(messages: bool = True) -> None:
    """Sets JAX up for your own programs as the commands do; call it before anything is computed.

    It makes each core a device (`medjax.wrappers.prepare_cpu`) and keeps compiled programs in the user's cache
    directory.

    Args:
      messages: print to stderr when a program takes more than two seconds to compile, and when it is compiled.
    """
    prepare_cpu()
    enable_compilation_cache()
    if messages:
        _announce_compiling()


def enable_compilation_cache() -> None:
    """Keeps compiled programs in the user's cache directory, unless the user chose another place."""
    chosen = getattr(jax.config, "jax_compilation_cache_dir", None)
    if chosen or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(root) / "medjax" / "xla"))


def compiled(lowered: Any, **options: Any) -> Any:
    """Runs `lowered.compile(**options)` in a thread of its own, so that Python handles signals meanwhile."""
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
    """Waits until the arrays are ready and returns them; unlike `device_get`, lets Python handle signals meanwhile."""
    for leaf in jax.tree.leaves(tree):
        while not leaf.is_ready():
            time.sleep(POLL_S)
    return tree


@functools.cache
def _announce_compiling() -> None:
    """Registers the listeners below, once; reading a program from the cache is not announced."""
    jax.monitoring.register_event_listener(_begins)
    jax.monitoring.register_event_duration_secs_listener(_ends)


def _begins(event: str, **_: object) -> None:
    if event == BEGINS:
        timer = threading.Timer(SILENT_S, _say, ["compiling ..."])
        timer.daemon = True
        _timers[threading.get_ident()] = timer
        timer.start()


def _ends(event: str, duration_secs: float, **about: object) -> None:
    if event == ENDS and (timer := _timers.pop(threading.get_ident(), None)):
        timer.cancel()
        if duration_secs > SILENT_S:
            _say(f"compiled {about.get('fun_name', 'a program')} in {duration_secs:.0f} s")


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
