"""Estimates how long playing takes, before anything compiles."""

from typing import Any

import jax

from medjax.commandline import in_words

# Time per vehicle slot and tick on one core, including the observation, on the fastest and on the slowest machine of
# docs/performance.md. Learning adds a tenth.
LEAST_NS, MOST_NS = 50.0, 200.0
SHORT_S = 30.0  # `reckoned_time` says nothing about shorter runs


def reckoned_time(env: Any, decisions: float) -> str:
    """Estimates the time to play a number of decisions on all devices, as a range, since processors differ.

    Args:
        env: a single environment, wrapped or not.
        decisions: decisions of the highway, summed over all environments and policies.

    Returns:
        Text such as "50 s to 3 min"; empty if the time is short, the device is not a CPU, or the environment's
        `config` has no vehicles and ticks.
    """
    config = getattr(env, "config", None)
    slots, ticks = (getattr(config, name, 0) for name in ("num_vehicles", "ticks_per_decision"))
    least_s, most_s = (
        decisions * slots * ticks * nanoseconds * 1e-9 / jax.device_count()
        for nanoseconds in (LEAST_NS, MOST_NS)
    )
    if jax.default_backend() != "cpu" or most_s < SHORT_S:
        return ""
    return f"{in_words(least_s)} to {in_words(most_s)}"
