"""How long playing takes, said before anything is compiled."""

from typing import Any

import jax

# Of a slot and tick on a core, observation included: the quickest and the slowest machine that docs/performance.md
# has had figures of. A learner adds a tenth.
LEAST_NS, MOST_NS = 50.0, 200.0
SHORT_S = 30.0  # what takes no longer is not worth a word


def reckoned_time(env: Any, decisions: float) -> str:
    """How long all devices together take for so many decisions of an environment: a range, as processors differ.

    Args:
        env: a single environment, wrapped or not.
        decisions: of the highway, those of all environments and policies.

    Returns:
        Such as "2 to 8 min"; empty where it is short, on other devices than CPUs, and for an environment whose
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
    for unit, seconds in (("s", 1.0), ("min", 60.0), ("h", 3600.0)):
        if most_s < 100.0 * seconds or unit == "h":
            break
    return f"{_two_digits(least_s / seconds)} to {_two_digits(most_s / seconds)} {unit}"


def _two_digits(value: float) -> str:
    """As many as a guess has."""
    return f"{float(f'{value:.2g}'):g}"
