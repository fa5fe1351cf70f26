"""Benchmarks: each module is a command that prints a table and can write JSON."""

import sys
from importlib.util import find_spec
from pathlib import Path

from medjax.commandline import fail
from medjax.hooks import command_name


def _check_train(command: str) -> None:
    """Ends the command if a train.py in the current folder, which Python searches first, would shadow our `train`."""
    found = find_spec("train")
    if found and found.origin:
        ours = Path(__file__).resolve().parents[1] / "train"
        if Path(found.origin).resolve().parent != ours:
            remedy = f"allowed in another folder, or as python -P -m {command}"
            sys.exit(fail(f"python -m {command}", f"train is {found.origin} here: {remedy}"))


if _name := command_name():
    _check_train(_name)
