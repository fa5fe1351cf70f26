"""Signal handling before a command's `main` starts: a signal during imports ends the command with one line.

`train` and `benchmarks` import `medjax` first, which imports this module first; it imports nothing of ours.
`medjax.commandline.command` takes over when `main` starts.
"""

import os
import signal
import sys
import threading
from types import FrameType

OURS = ("medjax", "train", "benchmarks")


def command_name() -> str:
    """The module of ours that `python -m` is about to run; empty in any other program."""
    # `sys.argv[0]` is "-m" while Python locates the module and imports its package.
    if sys.argv[:1] != ["-m"] or threading.current_thread() is not threading.main_thread():
        return ""
    name = sys.orig_argv[-len(sys.argv)]
    return name if name.partition(".")[0] in OURS else ""


def _imports(frame: FrameType | None) -> bool:
    """Whether an import is in progress."""
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def end(number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT and SIGTERM: ends the process, even during an import."""
    # Once `main` runs, the command has its own handler for SIGTERM but keeps this one for SIGINT, so delegate to the
    # former, which raises. An exception during the import of jaxlib would crash or turn into another error.
    by_now = signal.getsignal(signal.SIGTERM)
    if callable(by_now) and by_now is not end and not _imports(frame):
        by_now(number, frame)
        return
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


def begin() -> None:
    """If a command is about to run, installs the handlers and silences XLA's C++ log."""
    if not command_name():
        return
    # `command` sets this, too, but JAX may be imported before `main` starts and would set its own default.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, end)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, end)
