"""Mobile charging of electric vehicles on a highway, as a JAX-vectorised environment.

Members load on first access (PEP 562), so that a command's `--help` and its check of the input need not wait
a second for JAX and the simulator.
"""

import os
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from medjax import hooks

if hooks.command_name():
    # `commandline.command` sets this, too, but a command may import JAX before its `main` starts.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

if TYPE_CHECKING:  # for type checkers and editors
    from medjax.env.charging_env import ChargingEnv as ChargingEnv
    from medjax.env.reward import TERMS as TERMS
    from medjax.numerics.compilation import prepare_jax as prepare_jax
    from medjax.policies.pretrained import load_pretrained as load_pretrained
    from medjax.policies.rules import BASELINES as BASELINES
    from medjax.policies.saved import load_policy as load_policy
    from medjax.scenarios import SCENARIOS as SCENARIOS
    from medjax.scenarios import make as make
    from medjax.world.detectors import read_detectors as read_detectors
    from medjax.world.params import EnvConfig as EnvConfig
    from medjax.world.params import EnvParams as EnvParams
    from medjax.world.sumo_net import read_sumo_net as read_sumo_net
    from medjax.wrappers.agents import make_agents as make_agents

__version__ = "0.1.0"

_HOMES = {
    "BASELINES": "policies.rules",
    "SCENARIOS": "scenarios",
    "TERMS": "env.reward",
    "ChargingEnv": "env.charging_env",
    "EnvConfig": "world.params",
    "EnvParams": "world.params",
    "load_policy": "policies.saved",
    "load_pretrained": "policies.pretrained",
    "make": "scenarios",
    "make_agents": "wrappers.agents",
    "prepare_jax": "numerics.compilation",
    "read_detectors": "world.detectors",
    "read_sumo_net": "world.sumo_net",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    elif find_spec(f"{__name__}.{name}"):
        value = import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _draw(*state: Any, **how: Any) -> Any:
    from medjax.render.frame import render_state

    return render_state(*state, **how)


hooks.viewer = _draw
hooks.register()
