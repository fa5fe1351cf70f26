"""Wrappers around environments: auto-reset of a batch, episode log, normalisation, gymnax's old step.

`medjax.wrappers.gymnasium` is imported by itself: it needs the library.
"""

from medjax.wrappers.auto_reset import BatchAutoReset, BatchState
from medjax.wrappers.decide_every import DecideEvery
from medjax.wrappers.devices import environment_mesh, on_devices, prepare_cpu
from medjax.wrappers.episode_log import EpisodeLog, EpisodeLogState
from medjax.wrappers.legacy import LegacyStep
from medjax.wrappers.normalize import (
    RunningStats,
    init_stats,
    normalize,
    scale_reward,
    update_stats,
)
from medjax.wrappers.protocol import BatchEnvironment, Environment
from medjax.wrappers.randomize import RandomDemand, RandomDemandState, scale_demand
from medjax.wrappers.rows import for_true_rows, in_blocks
from medjax.wrappers.wrapper import TimeLimitAsEnd, Wrapper

__all__ = [
    "BatchAutoReset",
    "BatchEnvironment",
    "BatchState",
    "DecideEvery",
    "Environment",
    "EpisodeLog",
    "EpisodeLogState",
    "LegacyStep",
    "RandomDemand",
    "RandomDemandState",
    "RunningStats",
    "TimeLimitAsEnd",
    "Wrapper",
    "environment_mesh",
    "for_true_rows",
    "in_blocks",
    "init_stats",
    "normalize",
    "on_devices",
    "prepare_cpu",
    "scale_demand",
    "scale_reward",
    "update_stats",
]
