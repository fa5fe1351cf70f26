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


def scene(env, params, *, panel, ev_x, ev_lane, human=False):
    """A state of `env` with MED 0 in its service lane at MED_X and EV 0 booked on its slot `panel`.

    The MED drives at MED_SPEED where that is the fleet's service speed.
    """
    _, state = reset(env)(jax.random.key(0), params)
    vehicles, med, ev = state.vehicles, 0, env.config.num_meds
    both = jnp.array([med, ev])
    still = jnp.zeros_like(vehicles.x)
    vehicles = vehicles.replace(
        active=jnp.zeros_like(vehicles.active).at[both].set(True),
        x=vehicles.x.at[both].set(jnp.array([MED_X, ev_x])),
        lane=vehicles.lane.at[both].set(jnp.array([params.fleet.service_lane, ev_lane])),
        speed=vehicles.speed.at[both].set(MED_SPEED),
        desired_speed=vehicles.desired_speed.at[both].set(jnp.array([MED_SPEED, 30.0])),
        kind=vehicles.kind.at[ev].set(jnp.where(human, HUMAN_EV, AUTONOMOUS_EV)),
        lateral_offset=still,
        acceleration_noise=still,
        wander=still,
    )
    evs = state.evs.replace(
        med=state.evs.med.at[0].set(med),
        panel=state.evs.panel.at[0].set(panel),
        energy_j=state.evs.energy_j.at[0].set(SOC * params.ev_capacity_j),
    )
    meds = state.meds.replace(status=state.meds.status.at[0].set(IN_SERVICE))
    return state.replace(vehicles=vehicles, evs=evs, meds=meds)
