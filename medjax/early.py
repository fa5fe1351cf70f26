"""What holds for a command before its `main` begins: a signal while it is imported ends it in a line.

`medjax`, which `train` and `benchmarks` import first, imports this first; it imports nothing of ours.
`medjax.commandline.command` says how a command ends from there on.
"""

import os
import signal
import sys
import threading
from types import FrameType

OURS = ("medjax", "train", "benchmarks")


def command_name() -> str:
    """The module of ours that `python -m` is about to run; empty in every other program."""
    # While Python looks for it, and imports its package for that, the first argument is "-m".
    if sys.argv[:1] != ["-m"] or threading.current_thread() is not threading.main_thread():
        return ""
    name = sys.orig_argv[-len(sys.argv)]
    return name if name.partition(".")[0] in OURS else ""


def _imports(frame: FrameType | None) -> bool:
    """Whether something is being imported."""
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def end(number: int, frame: FrameType | None) -> None:
    """Handler of SIGINT and SIGTERM: ends the process, whatever is half imported."""
    # A command sets its own handler of SIGTERM, and leaves one of SIGINT that is not Python's own: this one. It raises
    # what ends the command; but while jaxlib is imported, that is a segmentation fault or an error of another kind.
    by_now = signal.getsignal(signal.SIGTERM)
    if callable(by_now) and by_now is not end and not _imports(frame):
        by_now(number, frame)
        return
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


def begin() -> None:
    """Hears signals, and keeps XLA's C++ quiet, where a command is about to run; else does nothing."""
    if not command_name():
        return
    # As `command` does, which is too late where JAX, with a default of its own, is imported before `main` begins.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, end)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, end)
