"""Connects packages that do not import each other: environment and rendering, Gymnasium and environment, commands."""

import sys
from collections.abc import Callable
from typing import Any

ENV_ID = "medjax/Charging-v0"

viewer: Callable[..., Any]
"""Called by `ChargingEnv.render` as `viewer(state, config, params, name=..., **size)`; `medjax` sets it."""


def command_name() -> str:
    """The module of ours that `python -m` is about to run; empty in any other program."""
    # `sys.argv[0]` is "-m" while Python locates the module and imports its package.
    name = sys.orig_argv[-len(sys.argv)] if sys.argv[:1] == ["-m"] else ""
    return name if name.partition(".")[0] in ("medjax", "train", "benchmarks") else ""


def register() -> None:
    """Registers `ENV_ID` with Gymnasium if it is loaded.

    Gymnasium has no plug-ins, and medjax does not import it just for this. `import medjax` registers if Gymnasium is
    already loaded; otherwise `medjax.wrappers.gymnasium`, which imports it, does.
    """
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is not None and ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="medjax.wrappers.gymnasium:ChargingGymEnv",
            vector_entry_point="medjax.wrappers.gymnasium:ChargingVectorEnv",
        )
