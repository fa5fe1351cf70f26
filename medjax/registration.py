"""The names by which Gymnasium finds the environment; Gymnasium has no plug-ins, and is not loaded for this.

Who is loaded second tells the first: `import medjax` registers where Gymnasium is there already, and
`medjax.wrappers.gymnasium`, which needs it, otherwise.
"""

import sys

ENV_ID = "medjax/Charging-v0"


def register() -> None:
    """Registers `ENV_ID` once Gymnasium is loaded."""
    gymnasium = sys.modules.get("gymnasium")
    if gymnasium is not None and ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID,
            entry_point="medjax.wrappers.gymnasium:ChargingGymEnv",
            vector_entry_point="medjax.wrappers.gymnasium:ChargingVectorEnv",
        )
