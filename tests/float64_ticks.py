"""Ticks of charging vehicles in float32 and in float64."""

import jax
import jax.numpy as jnp
import numpy as np

from medjax.env.tick import physics_tick
from medjax.traffic.step import drivers_of
from medjax.world.kinds import AUTONOMOUS_EV, MED
from medjax.world.state import IN_SERVICE


def platoon(env, params, x):
    """A MED in service at x and an EV charging in each of its slots."""
    shapes = jax.eval_shape(env.reset, jax.random.key(0), params)[1]
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    vehicles = state.vehicles.replace(
        x=np.array([x, x - 3.5, x - 3.5, x - 24.0, x + 17.0]),
        speed=np.full(5, 17.987),
        lane=np.array([2, 1, 3, 2, 2], np.int32),
        active=np.ones(5, bool),
        kind=np.array([MED, *[AUTONOMOUS_EV] * 4], np.int32),
        desired_speed=np.array([17.987, 30.0, 30.0, 30.0, 30.0]),
        road_order=np.arange(5, dtype=np.int32),
    )
    return state.replace(
        vehicles=vehicles,
        evs=state.evs.replace(energy_j=np.full(4, 3e7), charging_slot=np.arange(4, dtype=np.int32)),
        meds=state.meds.replace(
            energy_j=np.full(1, 1.3e9),
            status=np.full(1, IN_SERVICE, np.int32),
            service_speed=np.full(1, 17.987),
            service_lane=np.full(1, 2, np.int32),
        ),
    )


def played(env, params, state, ticks, float_type):
    """(states, tallies) of the ticks, `(ticks, ...)`, computed in this type."""

    def cast(tree):
        return jax.tree.map(
            lambda leaf: np.asarray(leaf, float_type if leaf.dtype.kind == "f" else leaf.dtype),
            jax.device_get(tree),
        )

    def run(state, params):
        drivers = drivers_of(state, env.config, params)

        def tick(state, number):
            state, step_stats = physics_tick(state, drivers, number, env.config, params)
            return state, (state, step_stats)

        return jax.lax.scan(tick, state, jnp.arange(ticks, dtype=jnp.int32))[1]

    with jax.enable_x64(float_type == np.float64):
        return jax.device_get(jax.jit(run)(cast(state), cast(params)))
