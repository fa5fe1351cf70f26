"""A planner that owns a simulator: an upper reference for learned policies, and slow."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.contract import Environment
from medjax.policies.policy import Policy
from medjax.traffic.arrivals import redraw

Plan = Callable[[jax.Array, Any, Any], jax.Array]
"""`(key, state, params)` to what stands for the next decisions, () int32: see `look_ahead`."""

ARRIVALS = 2**31 - 1  # folded into a future's key, beside the numbers of its decisions
AS_BASE = -1  # what a plan says where the base rule goes on


def look_ahead(env: Environment, base: Policy, samples: int = 16, hold: int = 16) -> Plan:
    """One step of policy improvement by simulation (Bertsekas and Castanon 1999, rollout algorithms).

    Tries each action, held for a while, and then `base`, to the end of the episode, in `samples` futures that are drawn
    by the key and are the same for all, never those of the episode. It leaves `base` only for an action whose mean gain
    is two standard errors above 0: the best of several noisy means would be an accident most of the time. Simulates
    `(1 + num_actions) * samples` futures.

    Args:
      env: a single environment.
      base: what it improves on.
      samples: futures, at least 2.
      hold: decisions, at least 1, for which an action stands: action 0 follows it.

    Returns:
      plan(key, state, params): the action to take and hold, or AS_BASE: follow `base` for as long.
    """
    candidates = jnp.arange(AS_BASE, env.num_actions, dtype=jnp.int32)

    def value(key: jax.Array, candidate: jax.Array, state: Any, params: Any) -> jax.Array:
        """Return of one future."""

        def decide(number: jax.Array, carry: tuple[Any, jax.Array]) -> Any:
            """One decision of it."""
            state, total = carry
            act_key, step_key = jax.random.split(jax.random.fold_in(key, number))
            own = jnp.where(number == 0, candidate, 0)
            follows = (candidate == AS_BASE) | (number >= hold)
            goes_on = base(act_key, env.get_obs(state, params), state, params).action
            action = jnp.where(follows, goes_on, own)
            _, state, reward, *_ = env.step_env(step_key, state, action, params)
            return state, total + reward

        state = redraw(jax.random.fold_in(key, ARRIVALS), state)
        left = jnp.asarray(params.episode_decisions - state.time, jnp.int32)
        steps = -(-left // env.decisions_per_step)
        return jax.lax.fori_loop(0, steps, decide, (state, jnp.zeros(())))[1]

    over_samples = jax.vmap(value, (0, None, None, None))
    over_candidates = jax.vmap(over_samples, (None, 0, None, None))

    def plan(key: jax.Array, state: Any, params: Any) -> jax.Array:
        returns = over_candidates(jax.random.split(key, samples), candidates, state, params)
        gain = returns[1:] - returns[0]
        mean, error = gain.mean(axis=1), gain.std(axis=1, ddof=1) / samples**0.5
        sure = env.action_mask(state, params) & (mean > 2.0 * error)
        best = jnp.argmax(jnp.where(sure, mean, -jnp.inf)).astype(jnp.int32)
        return jnp.where(sure.any(), best, AS_BASE)

    return plan
