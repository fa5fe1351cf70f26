"""Random agents of the soak test: MEDs that get any allowed orders at random times."""

import jax
import jax.numpy as jnp

from medjax.env.agents.actions import AgentActions, Parts, allowed_parts, give_orders
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState

SPEEDS = (5.0, 14.0, 22.0, 30.0)  # m/s
TOLD = 0.1  # chance that a MED gets new orders at a decision
LEAVES = 0.05  # chance that new orders are to leave


def told_at_random(
    key: jax.Array, state: EnvState, config: EnvConfig, params: EnvParams
) -> EnvState:
    """The state with new orders for some MEDs, wherever they are; masks remove orders that are not allowed."""
    exits = config.num_exits > 0
    lanes = tuple(range(config.num_lanes))
    actions = AgentActions(SPEEDS, lanes, config.num_ramps, exits, depots=config.num_depots)
    meds = (config.num_meds,)
    new_key, speed_key, lane_key, accept_key, leave_key = jax.random.split(key, 5)
    rule = actions.by_rule(state, params)
    told = jax.random.uniform(new_key, meds) < TOLD
    wishes = Parts(
        enter=rule.enter,
        speed=jax.random.randint(speed_key, meds, 0, len(SPEEDS)),
        lane=jax.random.randint(lane_key, meds, 0, config.num_lanes),
        accept=jax.random.randint(accept_key, meds, 0, 2),
        leave=jnp.where(
            told & (jax.random.uniform(leave_key, meds) < LEAVES),
            jax.random.randint(jax.random.fold_in(leave_key, 1), meds, 1, 1 + config.num_depots),
            0,
        ),
    )
    parts, _ = allowed_parts(wishes, actions.masks(state, config, params), rule)
    after, _ = give_orders(state, parts, actions, config, params)
    pick = {
        name: jnp.where(told, getattr(after.meds, name), getattr(state.meds, name))
        for name in ("service_speed", "service_lane", "accepts", "depot")
    }
    return after.replace(meds=state.meds.replace(**pick))
