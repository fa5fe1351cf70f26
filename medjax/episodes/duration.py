"""How long playing takes, said before anything is compiled."""

from typing import Any

import jax

from medjax.commandline import in_words

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
        Such as "50 s to 3 min"; empty where it is short, on other devices than CPUs, and for an environment whose
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
