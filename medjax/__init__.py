"""Mobile charging of electric vehicles on a highway, as a JAX-vectorised environment."""

from importlib.util import find_spec

from medjax.config import EnvConfig, EnvParams
from medjax.env import ChargingEnv
from medjax.policies import BASELINES
from medjax.reward import TERMS
from medjax.scenarios import SCENARIOS, make

__all__ = ["BASELINES", "SCENARIOS", "TERMS", "ChargingEnv", "EnvConfig", "EnvParams", "make"]
__version__ = "0.1.0"

if find_spec(
    "gymnasium"
):  # so that gymnasium.make("medjax/Charging-v0") finds it: Gymnasium has no plug-ins
    import medjax.wrappers.gymnasium  # noqa: F401
