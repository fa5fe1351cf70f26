"""Rule-based dispatchers, the baselines for learned policies.

Each entry of `BASELINES` is `build(env) -> policy` (`medjax.policies.policy.Policy`). Rules ignore observations, which
may be None, and read the state of the highway beneath any wrappers. They never return a masked action.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from medjax.env.contract import Environment
from medjax.env.forecast import Need, expected_need, forecast_need
from medjax.env.observation import NEED_WINDOW_S, clock_features
from medjax.errors import InputError
from medjax.policies.policy import Choice, Policy, rule
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.presets import SCENARIOS
from medjax.world.state import NOT_BOOKED, EnvState

Act = Callable[[jax.Array, EnvState, EnvParams], jax.Array]


def _of_highway(env: Environment, act: Act) -> Policy:
    """Builds a rule from `act(mask, state, params)`, given allowed actions and the state and params of the highway."""
    if hasattr(env, "num_agents"):
        raise InputError(
            f"a dispatching rule does not fit {env.num_agents} agents: allowed env.env, their highway"
        )

    def on_wrapped(key: jax.Array, state: Any, params: Any) -> jax.Array:
        return act(env.action_mask(state, params), *env.highway(state, params)).astype(jnp.int32)

    return rule(on_wrapped, env.num_actions)


def none(env: Environment) -> Policy:
    """Never sends a MED: the paper's "no action"."""
    return rule(lambda key, state, params: jnp.zeros((), jnp.int32), env.num_actions)


def slow(env: Environment) -> Policy:
    """Never sends a MED, but EVs that are low on charge drive as slowly as MEDs do.

    A control that isolates the effect of driving slowly from the effect of charging. Low is below the request
    threshold, slow is the service speed of MEDs.
    """

    def params_transform(params: EnvParams) -> EnvParams:
        """Makes every driver of a low EV slow down, through `medjax.charging.range.apply_eco_speed`."""
        drivers = params.drivers.replace(
            eco_compliance=1.0,
            eco_speed=params.fleet.service_speed,
            eco_horizon_m=math.inf,  # no charge is enough
            eco_soc=params.charging.request_soc,
        )
        return params.replace(drivers=drivers)

    return none(env).replace(params_transform=params_transform)


def random(env: Environment) -> Policy:
    """Uniform over the allowed actions: the paper's "random choice"."""

    def act(key: jax.Array, state: Any, params: Any) -> jax.Array:
        logits = jnp.where(env.action_mask(state, params), 0.0, -jnp.inf)
        return jax.random.categorical(key, logits).astype(jnp.int32)

    return rule(act, env.num_actions)


def periodic(env: Environment) -> Policy:
    """Spreads the fleet evenly over the episode, ramp after ramp; passes over ramps that cannot send."""
    num_ramps = env.config.num_ramps

    def act(mask: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        """The ramp whose turn it is, or the next one that can send, if a MED is due, `()` int32; else 0."""
        if not num_ramps:
            return jnp.zeros((), jnp.int32)
        sent = state.stats.meds_dispatched.astype(jnp.int32)
        due = state.time * params.fleet.size >= sent * params.episode_decisions
        ramps = 1 + (sent + jnp.arange(num_ramps)) % num_ramps
        allowed = mask[ramps]
        return jnp.where(due & allowed.any(), ramps[jnp.argmax(allowed)], 0)

    return _of_highway(env, act)


def paced(env: Environment, interval_s: float = 32.0, ramp: int = 1) -> Policy:
    """One MED every interval_s, always from the same ramp.

    The defaults do best on `paper`: `python -m benchmarks.tune` compares them.

    Args:
      interval_s: s between two MEDs; a cooldown may make it longer.
      ramp: counted from 1; the last ramp if there are fewer.
    """
    action = min(ramp, env.config.num_ramps)

    def act(mask: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        due = state.time * env.config.decision_s >= state.stats.meds_dispatched * interval_s
        return jnp.where(due & mask[action], action, 0)

    return _of_highway(env, act)


def stranded_need(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Unserved low EVs that a MED from each ramp would meet, `(num_ramps,)`.

    Counts EVs below the request threshold without a booking, within booking reach of a MED at the ramp.
    """
    low = state.evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    waits = (state.evs.med == NOT_BOOKED) & ~state.evs.is_depleted
    needy = state.vehicles.active[config.ev_slots] & low & waits
    ahead = params.road.ramp_x_m[:, None] - state.vehicles.x[config.ev_slots][None, :]
    meets = (ahead <= params.charging.reach_ahead_m) & (ahead >= -params.charging.reach_behind_m)
    return jnp.sum(meets & needy, axis=1, dtype=jnp.int32)


def _where_needed(
    env: Environment, need: Callable[[EnvState, EnvParams], jax.Array], enough: float
) -> Policy:
    """Sends a MED from the allowed ramp with the greatest need `(num_ramps,)`, if it is at least `enough`."""
    if not env.config.num_ramps:
        return none(env)

    def act(mask: jax.Array, state: EnvState, params: EnvParams) -> jax.Array:
        needs = jnp.where(mask[1:], need(state, params), -jnp.inf)
        return jnp.where(needs.max() >= enough, 1 + jnp.argmax(needs), 0).astype(jnp.int32)

    return _of_highway(env, act)


def greedy(env: Environment) -> Policy:
    """Sends a MED where the most low EVs without a slot are about to pass, if there are at least two."""
    return _where_needed(env, lambda state, params: stranded_need(state, env.config, params), 2.0)


def forecast(env: Environment, window_s: float = 60.0, enough: float = 5.0) -> Policy:
    """Sends a MED where most EVs will be in need of it (`forecast_need`), once `enough` are.

    The defaults do best on `paper`: `python -m benchmarks.tune` compares them.

    Args:
      window_s: forecast window, s.
      enough: EVs in need at which it sends a MED.
    """
    return _where_needed(
        env, lambda state, params: forecast_need(state, env.config, params, window_s), enough
    )


class Budget(struct.PyTreeNode):
    """Weights of `budgeted`, in EVs per unit.

    The defaults did best on `paper`: `python -m benchmarks.tune --rules budgeted --episodes 1000` (docs/results.md).
    """

    pack: float = 5.03  # per battery capacity that EVs in need lack
    coming: float = 1.28  # per expected EV in need
    free: float = -1.01  # per free slot near the ramp
    ahead: float = 22.97  # per share of the fleet at the depot in excess of the share of time left
    time_left: float = -3.62  # per share of the episode left
    # Per ramp, minus the threshold; further ramps use the last value.
    ramp: tuple[float, ...] = (-3.94, -6.55, -5.88, -6.56)

    def margin(self, need: Need, at_depot: jax.Array, time_left: jax.Array) -> jax.Array:
        """Advantage of sending from each ramp over waiting, in EVs, `(..., num_ramps)`.

        Args:
          need: within `NEED_WINDOW_S`, `(..., num_ramps)`.
          at_depot: `(...)`, share of the fleet at the depots.
          time_left: `(...)`, share of the episode.
        """
        ramps = need.there.shape[-1]
        ramp = jnp.stack([jnp.asarray(self.ramp[min(i, len(self.ramp) - 1)]) for i in range(ramps)])
        left = self.ahead * (at_depot - time_left) + self.time_left * time_left
        return (
            need.there
            + self.pack * need.shortfall
            + self.coming * need.coming
            + self.free * need.free
            + left[..., None]
            + ramp
        )


def budget_of(scenario: str) -> Budget:
    """The numbers of `budgeted` that were tuned on a preset, else those of `paper`."""
    return Budget(**SCENARIOS[scenario].budget)


def tuned_budget(env: Environment) -> Budget:
    """`budget_of` the preset of an environment, wrapped or not; of `paper` for an environment of one's own."""
    highway: Any = env
    while hasattr(highway, "env"):
        highway = highway.env
    recipe = getattr(highway, "recipe", None)  # an environment of one's own may have none
    return budget_of(recipe.scenario) if recipe else Budget()


def budgeted(env: Environment, budget: Budget | None = None) -> Policy:
    """Sends a MED where it is worth most; the more MEDs are left for the time left, the less need it takes.

    Args:
      env: a single environment.
      budget: its numbers, which are the policy's weights; None takes `tuned_budget`.
    """
    if not env.config.num_ramps:
        return none(env)

    def act(weights: Budget, key: jax.Array, obs: Any, state: Any, params: Any) -> Choice:
        """Sends from the allowed ramp with the greatest `Budget.margin`, unless that is negative."""
        mask = env.action_mask(state, params)
        highway, numbers = env.highway(state, params)
        need = expected_need(highway, env.config, numbers, NEED_WINDOW_S)
        time_left, _, at_depot, _ = clock_features(highway, numbers)
        margin = jnp.where(mask[1:], weights.margin(need, at_depot, time_left), -jnp.inf)
        action = jnp.where(margin.max() >= 0.0, 1 + jnp.argmax(margin), 0).astype(jnp.int32)
        return Choice(action, jax.nn.one_hot(action, env.num_actions, dtype=jnp.float32))

    return Policy(act, tuned_budget(env) if budget is None else budget)


BASELINES: dict[str, Callable[[Environment], Policy]] = {
    build.__name__: build
    for build in (none, slow, random, periodic, paced, greedy, forecast, budgeted)
}
