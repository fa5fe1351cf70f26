"""One MED in service and one EV booked on it, alone on the road."""

import functools

import jax
import jax.numpy as jnp

from medjax.world.kinds import AUTONOMOUS_EV, HUMAN_EV
from medjax.world.state import IN_SERVICE

MED_SPEED, MED_X, SOC = 22.0, 500.0, 0.35


@functools.cache
def reset(env):
    """Compiled once for all scenes of an environment."""
    return jax.jit(env.reset)


def put(state, **parts):
    """The state with values in slots: `put(state, evs={"med": (0, NOT_BOOKED)}, vehicles=...)`."""
    for part, columns in parts.items():
        old = getattr(state, part)
        new = {name: getattr(old, name).at[slots].set(x) for name, (slots, x) in columns.items()}
        state = state.replace(**{part: old.replace(**new)})
    return state


def scene(env, params, *, charging_slot, ev_x, ev_lane, human=False):
    """A state of `env` with MED 0 in its service lane at MED_X and EV 0 booked on its charging slot.

    The MED drives at MED_SPEED where that is the fleet's service speed.
    """
    _, state = reset(env)(jax.random.key(0), params)
    ev, both = env.config.num_meds, jnp.array([0, env.config.num_meds])
    vehicles = {
        "active": (both, True),
        "x": (both, jnp.array([MED_X, ev_x])),
        "lane": (both, jnp.array([params.fleet.service_lane, ev_lane])),
        "speed": (both, MED_SPEED),
        "desired_speed": (both, jnp.array([MED_SPEED, 30.0])),
        "kind": (ev, jnp.where(human, HUMAN_EV, AUTONOMOUS_EV)),
    }
    vehicles |= dict.fromkeys(
        ("lateral_offset", "acceleration_noise", "wander"), (slice(None), 0.0)
    )
    state = put(state, vehicles={"active": (slice(None), False)})
    evs = {
        "med": (0, 0),
        "charging_slot": (0, charging_slot),
        "energy_j": (0, SOC * params.ev_capacity_j),
    }
    return put(state, vehicles=vehicles, evs=evs, meds={"status": (0, IN_SERVICE)})
