"""Dispatchers that are not learned: what learning has to beat.

Each entry of `BASELINES` is `build(env) -> act`, and `act(key, state, params)` returns the action of
one environment, () int32; batch it with `jax.vmap`. A masked action is never returned.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from medjax.config import EnvParams
from medjax.env import ChargingEnv
from medjax.need import forecast_need
from medjax.state import NOT_BOOKED, EnvState

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


def forecast(env: ChargingEnv, window_s: float = 45.0, enough: float = 3.5) -> Act:
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


def look_ahead(env: ChargingEnv, base: Act, samples: int = 8, horizon_s: float = 240.0) -> Act:
    """Plays every action forward, then `base`, and takes the one of the best mean return.

    One step of policy improvement by simulation (Bertsekas and Castanon 1999, rollout algorithms): an upper
    reference for learned policies, and slow: `num_actions * samples` futures a decision. All actions meet the
    same `samples` futures, drawn by the key, never those of the episode.

    Args:
      base: acts from the second decision on.
      samples: futures.
      horizon_s: s played; not beyond the end of the episode.
    """
    decisions = max(1, round(horizon_s / env.config.decision_s))

    def value(key: jax.Array, state: EnvState, first: jax.Array, params: EnvParams) -> jax.Array:
        """Return of one future."""

        def decide(
            carry: tuple[EnvState, jax.Array], number: jax.Array
        ) -> tuple[tuple[EnvState, jax.Array], None]:
            """One decision of it; what comes after the end of the episode does not count."""
            state, total = carry
            act_key, step_key = jax.random.split(jax.random.fold_in(key, number))
            action = jnp.where(number == 0, first, base(act_key, state, params))
            live = state.time < params.episode_decisions
            _, state, reward, _, _, _ = env.step_env(step_key, state, action, params)
            return (state, total + jnp.where(live, reward, 0.0)), None

        start = (state, jnp.zeros(()))
        return jax.lax.scan(decide, start, jnp.arange(decisions, dtype=jnp.int32))[0][1]

    over_futures = jax.vmap(value, (0, None, None, None))
    over_actions = jax.vmap(over_futures, (None, None, 0, None))

    def act(key: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        actions = jnp.arange(env.num_actions, dtype=jnp.int32)
        values = over_actions(jax.random.split(key, samples), state, actions, params).mean(axis=1)
        allowed = env.action_mask(state, params)
        return jnp.argmax(jnp.where(allowed, values, -jnp.inf)).astype(jnp.int32)

    return act


BASELINES: dict[str, Callable[[ChargingEnv], Act]] = {
    "none": none,
    "random": random,
    "periodic": periodic,
    "paced": paced,
    "greedy": greedy,
    "forecast": forecast,
}
