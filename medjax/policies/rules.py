"""Dispatchers that are not learned: what learning has to beat.

Each entry of `BASELINES` is `build(env) -> act`, and `act(key, state, params)` returns the action of
one environment, () int32; batch it with `jax.vmap`. A masked action is never returned.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from medjax.env.charging_env import ChargingEnv
from medjax.env.forecast import forecast_need
from medjax.world.params import EnvParams
from medjax.world.state import NOT_BOOKED, EnvState

Act = Callable[[jax.Array, EnvState, EnvParams], jax.Array]


def none(env: ChargingEnv) -> Act:
    """Never sends a MED: the paper's "no action"."""

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        return jnp.zeros((), jnp.int32)

    return act


def random(env: ChargingEnv) -> Act:
    """Uniform over the allowed actions: the paper's "random choice"."""

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        logits = jnp.where(env.action_mask(state, params), 0.0, -jnp.inf)
        return jax.random.categorical(key, logits).astype(jnp.int32)

    return act


def periodic(env: ChargingEnv) -> Act:
    """Spreads the fleet evenly over the episode, ramp after ramp."""

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        sent = state.tally.meds_dispatched.astype(jnp.int32)
        due = state.time * params.fleet.size >= sent * params.episode_decisions
        ramp = 1 + sent % env.config.num_ramps if env.config.num_ramps else 0
        send = due & env.action_mask(state, params)[-1]
        return jnp.where(send, ramp, 0).astype(jnp.int32)

    return act


def paced(env: ChargingEnv, interval_s: float = 34.0, ramp: int = 1) -> Act:
    """One MED every interval_s, always from the same ramp.

    The defaults are those that do best on `paper`: `python -m benchmarks.tune` compares them.

    Args:
      interval_s: s between two MEDs; a cooldown may make it longer.
      ramp: 1 is the first; the last one where there are fewer.
    """
    action = min(ramp, env.config.num_ramps)

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        due = state.time * env.config.decision_s >= state.tally.meds_dispatched * interval_s
        send = due & env.action_mask(state, params)[action]
        return jnp.where(send, action, 0).astype(jnp.int32)

    return act


def stranded_need(env: ChargingEnv, state: EnvState, params: EnvParams) -> jax.Array:
    """EVs that a MED from each ramp would meet and that nobody serves yet, `(num_ramps,)`.

    Counts EVs below the request threshold without a booking, from as far behind the ramp as a MED may
    be asked to the end of its reach: those that would otherwise run out soonest.
    """
    config = env.config
    x = state.vehicles.x[config.ev_slots]
    low = state.evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    needy = state.vehicles.active[config.ev_slots] & low & (state.evs.med == NOT_BOOKED)
    ahead = params.road.ramp_x_m[:, None] - x[None, :]
    meets = (ahead <= params.charging.reach_ahead_m) & (ahead >= -params.charging.reach_behind_m)
    return jnp.sum(meets & needy, axis=1)


def _where_needed(
    env: ChargingEnv, need: Callable[[EnvState, EnvParams], jax.Array], enough: float
) -> Act:
    """Sends a MED from the ramp of the greatest need `(num_ramps,)`, once it is `enough`."""
    if not env.config.num_ramps:
        return none(env)

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        needs = need(state, params)
        send = (needs.max() >= enough) & env.action_mask(state, params)[-1]
        return jnp.where(send, 1 + jnp.argmax(needs), 0).astype(jnp.int32)

    return act


def greedy(env: ChargingEnv) -> Act:
    """Sends a MED where most low EVs without a slot are about to pass, once two or more are."""
    return _where_needed(env, lambda state, params: stranded_need(env, state, params), 2.0)


def forecast(env: ChargingEnv, window_s: float = 60.0, enough: float = 3.5) -> Act:
    """Sends a MED where most EVs will be in need of it (`forecast_need`), once `enough` are.

    The defaults are those that do best on `paper`: `python -m benchmarks.tune` compares them.

    Args:
      window_s: s that the forecast looks ahead.
      enough: EVs.
    """
    config = env.config
    return _where_needed(
        env, lambda state, params: forecast_need(state, config, params, window_s), enough
    )


AS_BASE = -1  # what a plan says where the base rule goes on


def look_ahead(env: ChargingEnv, base: Act, samples: int = 16, hold: int = 16) -> Act:
    """A planner that owns a simulator: an upper reference for learned policies, and slow.

    One step of policy improvement by simulation (Bertsekas and Castanon 1999, rollout algorithms). Tries each action,
    held for a while, and then `base`, to the end of the episode, in `samples` futures that are drawn by the key and are
    the same for all, never those of the episode. It leaves `base` only for an action whose mean gain is two standard
    errors above 0: the best of several noisy means would be an accident most of the time. Simulates
    `(1 + num_actions) * samples` futures.

    Args:
      base: what it improves on.
      samples: futures, at least 2.
      hold: decisions, at least 1, for which an action stands: action 0 follows it.

    Returns:
      act(key, state, params): the action to take and hold, or AS_BASE: follow `base` for as long.
    """
    candidates = jnp.arange(AS_BASE, env.num_actions, dtype=jnp.int32)

    def value(
        key: jax.Array, candidate: jax.Array, state: EnvState, params: EnvParams
    ) -> jax.Array:
        """Return of one future."""

        def decide(number: jax.Array, carry: tuple[EnvState, jax.Array]) -> Any:
            """One decision of it."""
            state, total = carry
            act_key, step_key = jax.random.split(jax.random.fold_in(key, number))
            own = jnp.where(number == 0, candidate, 0)
            follows = (candidate == AS_BASE) | (number >= hold)
            action = jnp.where(follows, base(act_key, state, params), own)
            _, state, reward, *_ = env.step_env(step_key, state, action, params)
            return state, total + reward

        left = jnp.asarray(params.episode_decisions - state.time, jnp.int32)
        return jax.lax.fori_loop(0, left, decide, (state, jnp.zeros(())))[1]

    over_samples = jax.vmap(value, (0, None, None, None))
    over_candidates = jax.vmap(over_samples, (None, 0, None, None))

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        returns = over_candidates(jax.random.split(key, samples), candidates, state, params)
        gain = returns[1:] - returns[0]
        mean, error = gain.mean(axis=1), gain.std(axis=1, ddof=1) / samples**0.5
        sure = env.action_mask(state, params) & (mean > 2.0 * error)
        best = jnp.argmax(jnp.where(sure, mean, -jnp.inf)).astype(jnp.int32)
        return jnp.where(sure.any(), best, AS_BASE)

    return act


BASELINES: dict[str, Callable[[ChargingEnv], Act]] = {
    "none": none,
    "random": random,
    "periodic": periodic,
    "paced": paced,
    "greedy": greedy,
    "forecast": forecast,
}
