"""A road with plugs at its exits and nobody on it, and EVs put before the first exit."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from medjax.charging.energy import cruising
from tests.charging.scene import put

SHORTER_S = 180.0  # by so much the wait must be shorter
EXITS = np.array([5000.0, 10_000.0, 15_000.0])


@functools.cache
def quiet_road():
    """Twenty kilometres with exits at 5, 10 and 15 km, two plugs at each, true packs, no demand; everybody sees."""
    size = {"num_evs": 8, "num_gas": 0, "length_m": 20_000, "exit_x_m": EXITS, "num_plugs": 2}
    size |= {"exit_share": 0.0, "battery_scale": 1.0, "mainline_per_h": 0, "ramp_per_h": 0}
    env, params = medjax.make("paper", **size, queue_seen_share=1.0)
    return env, params, jax.jit(env.reset)(jax.random.key(0), params)[1]


def with_evs(state, config, energy_j, free_in_s, *, sees=True, **vehicles):
    """The state with EVs in the rightmost lane, half a kilometre before the first exit, and when plugs are free."""
    usual = {"x": 4500.0, "destination": 20_000.0, "speed": 30.0, "lateral_offset": 0.0}
    usual |= {"lane": config.num_lanes - 1, "active": True}
    state = put(
        state,
        vehicles={name: (config.ev_slots, value) for name, value in (usual | vehicles).items()},
        evs={"energy_j": (slice(None), energy_j), "sees_queues": (slice(None), sees)},
    )
    free = jnp.broadcast_to(jnp.asarray(free_in_s, jnp.float32)[:, None], (EXITS.size, 2))
    return state.replace(plugs_free_in_s=free)


def energy_for(way_m, params):
    """What takes an EV so far at 30 m/s with `stop_soc` left, J."""
    speed, power_w = cruising(params)
    reserve = float(params.charging.stop_soc * params.ev_capacity_j)
    return reserve + np.asarray(way_m) * float(power_w / speed)
