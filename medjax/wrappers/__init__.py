"""Wrappers of environments: batched auto-reset, episode log, random demand and others.

Import `medjax.wrappers.gymnasium` separately, because it needs Gymnasium.
"""

from typing import Any

from medjax.env.contract import BatchEnvironment, Environment
from medjax.env.wrapper import Wrapper
from medjax.numerics.devices import environment_mesh, on_devices, prepare_cpu
from medjax.numerics.rows import for_true_rows, in_blocks
from medjax.wrappers.auto_reset import BatchAutoReset, BatchState
from medjax.wrappers.decide_every import DecideEvery
from medjax.wrappers.demand import RandomDemand, RandomDemandState, scale_demand
from medjax.wrappers.episode_log import EpisodeLog, EpisodeLogState
from medjax.wrappers.time_limit import TimeLimitAsEnd

__all__ = [
    "BatchAutoReset",
    "BatchEnvironment",
    "BatchState",
    "DecideEvery",
    "Environment",
    "EpisodeLog",
    "EpisodeLogState",
    "RandomDemand",
    "RandomDemandState",
    "TimeLimitAsEnd",
    "Wrapper",
    "environment_mesh",
    "for_true_rows",
    "in_blocks",
    "on_devices",
    "prepare_cpu",
    "scale_demand",
]


def __getattr__(name: str) -> Any:
    if name == "LegacyStep":
        raise ImportError(
            "LegacyStep is gone: use gymnax.wrappers.LegacyStepAPIWrapper, which takes any environment"
        )
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
