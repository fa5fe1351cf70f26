"""Applies agents' decisions to the state: one MED enters, and MEDs in service get their orders."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.env.agents.actions import AgentActions, Parts
from medjax.env.dispatch import is_allowed
from medjax.env.trips import leaving_early
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import IN_SERVICE, MERGING, QUEUED, EnvState


def allowed_parts(
    choices: Parts[jax.Array], masks: Parts[jax.Array], rule: Parts[jax.Array]
) -> tuple[Parts[jax.Array], jax.Array]:
    """Replaces masked choices `(A,)` by the rule's; also returns how many were replaced for each agent, `(A,)`."""

    def check(choice: jax.Array, mask: jax.Array, usual: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Choices of a part, and where the rule's choice replaced a different one."""
        fine = is_allowed(choice, mask)
        return jnp.where(fine, choice, usual), ~fine & (choice != usual)

    checked = [check(*each) for each in zip(choices, masks, rule, strict=True)]
    wrong = [jnp.asarray(refused, jnp.int32) for _, refused in checked]
    return Parts(*(choice for choice, _ in checked)), sum(wrong, jnp.zeros_like(wrong[0]))


def give_orders(
    state: EnvState,
    parts: Parts[jax.Array],
    actions: AgentActions,
    config: EnvConfig,
    params: EnvParams,
) -> tuple[EnvState, jax.Array]:
    """Gives the agents in service their orders, and derives the dispatcher's action.

    Args:
      parts: allowed choices `(A,)`.
      actions: action spaces of the choices.

    Returns:
      (state, dispatcher's action () int32: 0, or the ramp of the agent that enters, counted from 1). Only one MED
      enters per decision: if agents of several depots enter, the one with the last ramp does.
    """
    vehicles, meds = state.vehicles, state.meds
    serves = meds.status == IN_SERVICE
    answers = serves | (meds.status == QUEUED) | (meds.status == MERGING)
    speed = jnp.asarray(actions.speeds, jnp.float32)[parts.speed]
    lane = jnp.asarray(actions.lanes, jnp.int32)[parts.lane]
    if actions.exits:
        leaves = serves & (parts.leave > 0)
        vehicles = vehicles.replace(destination=leaving_early(vehicles, leaves, config, params))
        meds = meds.replace(depot=jnp.where(leaves, parts.leave - 1, meds.depot))
    meds = meds.replace(
        service_speed=jnp.where(serves, speed, meds.service_speed),
        service_lane=jnp.where(serves, lane, meds.service_lane),
        accepts=jnp.where(answers, parts.accept > 0, meds.accepts),
    )
    return state.replace(vehicles=vehicles, meds=meds), jnp.max(parts.enter, initial=0)
