"""Where rooms meet that do not import each other: the environment and its pictures, Gymnasium and the environment."""

import sys
from collections.abc import Callable
from typing import Any

ENV_ID = "medjax/Charging-v0"

viewer: Callable[..., Any]
"""What `ChargingEnv.render` draws with, `viewer(state, config, params, name=..., **size)`; `medjax` sets it."""


def register() -> None:
    """Registers `ENV_ID` once Gymnasium is loaded.

    Gymnasium has no plug-ins, and is not loaded for this. Who is loaded second tells the first: `import medjax`
    registers where Gymnasium is there already, and `medjax.wrappers.gymnasium`, which needs it, otherwise.
    """
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is not None and ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="medjax.wrappers.gymnasium:ChargingGymEnv",
            vector_entry_point="medjax.wrappers.gymnasium:ChargingVectorEnv",
        )
