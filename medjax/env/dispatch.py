"""The dispatcher's action: which ramp a MED is sent from, and when one may be sent."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import AT_DEPOT, QUEUED, EnvState


def action_mask(state: EnvState, config: EnvConfig) -> jax.Array:
    """Allowed actions, `(1 + num_ramps,)` bool.

    Action 0 sends none and is always allowed. Action r sends a MED from ramp r - 1, allowed while no
    cooldown runs and a MED is at the depot.
    """
    can_send = (state.cooldown_s <= 0.0) & jnp.any(state.meds.status == AT_DEPOT)
    return jnp.concatenate([jnp.ones((1,), bool), jnp.full((config.num_ramps,), can_send)])


def dispatch(
    state: EnvState, action: jax.Array, config: EnvConfig, params: EnvParams
) -> tuple[EnvState, jax.Array, jax.Array]:
    """Sends a MED to a ramp, where it waits for a safe gap.

    An action out of range, or one that is masked, counts as 0.

    Args:
      action: () integer.

    Returns:
      (state, sent () bool, invalid () bool)
    """
    action = jnp.asarray(action).astype(jnp.int32)
    in_range = (action >= 0) & (action < config.num_actions)
    mask = action_mask(state, config)
    allowed = in_range & mask[jnp.clip(action, 0, config.num_actions - 1)]
    sent = allowed & (action > 0)
    meds = state.meds
    # argmax finds the first MED at the depot.
    chosen = sent & (jnp.arange(config.num_meds) == jnp.argmax(meds.status == AT_DEPOT))
    meds = meds.replace(
        status=jnp.where(chosen, QUEUED, meds.status),
        ramp=jnp.where(chosen, action - 1, meds.ramp),
    )
    cooldown = jnp.where(sent, params.fleet.cooldown_s, state.cooldown_s)
    return state.replace(meds=meds, cooldown_s=cooldown), sent, ~allowed
