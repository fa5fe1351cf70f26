"""ChargingEnv: MEDs dispatched onto a highway to charge EVs as they drive.

Composes traffic, charging, dispatch, observation and reward, and reads like the paper's section
"Experiment settings". The step contract is gymnax 1.0's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from medjax.charging.booking import Offers, Requests, book, can_serve, panel_flags
from medjax.env.dispatch import action_mask, dispatch
from medjax.env.metrics import episode_metrics
from medjax.env.observation import FlatObservation, Observation, observe
from medjax.env.reset import initial_state
from medjax.env.reward import TERMS, Outcome, RewardTerm, total_reward
from medjax.env.spaces import Box, Discrete
from medjax.env.tick import drive_energy, physics_tick
from medjax.numerics.sums import count_down
from medjax.traffic.entry import admit
from medjax.traffic.following import by_kind
from medjax.traffic.motion import ornstein_uhlenbeck
from medjax.traffic.step import drivers_of, vehicle_kinds
from medjax.world.params import AUTONOMOUS_EV, EnvConfig, EnvParams, validate_config
from medjax.world.presets import Recipe
from medjax.world.state import AT_DEPOT, NOT_BOOKED, RETIRED, EnvState, Tally

Step = tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, dict[str, Any]]


class ChargingEnv:
    """The dispatching problem as a pure-functional environment of one highway.

    Every method is pure and jits; batch with `jax.vmap` over keys, states, actions and params.

    Args:
      config: sizes and cadences; one compiled program each.
      reward: terms by name; `params.reward_weights` must hold a weight for each.
      observation: flat observation, `size(config)` and `__call__(state, config, params)`.
      name: shown in logs.
      probe: what to report of the state after every physics tick, `probe(state)`, in `info["ticks"]`, and of the one
        that the first tick starts from, with those who just entered or booked, in `info["begun"]`; None: nothing.

    Attributes:
      recipe: how `medjax.make` was called; None where it was not.

    Raises:
      InputError: one line, if config is none.
    """

    recipe: Recipe | None = None

    def __init__(
        self,
        config: EnvConfig,
        reward: Mapping[str, RewardTerm] = TERMS,
        observation: Any = None,
        name: str = "charging",
        probe: Callable[[EnvState], Any] | None = None,
    ) -> None:
        validate_config(config)
        self.config = config
        self.reward = dict(reward)
        self.observation = FlatObservation() if observation is None else observation
        self.name = name
        self.probe = probe

    @property
    def num_actions(self) -> int:
        """0 sends no MED, r in 1 .. num_ramps sends one from ramp r."""
        return self.config.num_actions

    def action_space(self, params: EnvParams | None = None) -> Discrete:
        """Discrete(1 + num_ramps)."""
        return Discrete(self.num_actions)

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """A float32 vector; scaled to about [-1, 1], not bounded by it."""
        return Box(-jnp.inf, jnp.inf, (self.observation.size(self.config),))

    def reset(self, key: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Starts an episode on a road in mid-traffic.

        Returns:
          (observation (size,) float32, state)
        """
        state = initial_state(key, self.config, params)
        return self.observation(state, self.config, params), state

    def step(self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams) -> Step:
        """One decision, and a reset in the same step when the episode ends.

        Returns:
          (observation, state, reward, terminated, truncated, info). Observation and state are those
          of the next episode when this one ended; `info["final_observation"]` is always the
          observation that the decision itself led to. `info["action_mask"]` fits the returned state.
        """
        step_key, reset_key = jax.random.split(key)
        last_obs, last_state, reward, terminated, truncated, info = self.step_env(
            step_key, state, action, params
        )
        ends = terminated | truncated
        # Unbatched, cond spares the reset; under vmap both sides run (wrappers.BatchAutoReset).
        obs, state = jax.lax.cond(
            ends, lambda: self.reset(reset_key, params), lambda: (last_obs, last_state)
        )
        info = info | {
            "final_observation": last_obs,
            "action_mask": self.action_mask(state, params),
        }
        return obs, state, reward, terminated, truncated, info

    def step_env(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> Step:
        """One decision without a reset.

        Args:
          key: random key of this decision.
          state: of one environment.
          action: () integer; out of range or masked counts as 0 and is counted in the metrics.

        Returns:
          (observation (size,) float32, state, reward () float32, terminated () bool, always False;
          truncated () bool, at params.episode_decisions; info with "metrics" of the episode so far,
          weighted "reward_terms", "action_mask", "tally" of this decision, "begun" and "ticks" of the probe)
        """
        entry_key, noise_key = jax.random.split(key)
        before = state
        with jax.named_scope("dispatch"):
            state, sent, invalid = dispatch(state, action, self.config, params)
        with jax.named_scope("entry"):
            state, happened = admit(entry_key, state, self.config, params)
        with jax.named_scope("booking"):
            state = self._book(state, params)
        with jax.named_scope("noise"):
            state = self._perturb(noise_key, state, params)

        begun = self.probe(state) if self.probe else None
        drivers = drivers_of(state, self.config, params)

        def tick(
            carry: tuple[EnvState, Tally], index: jax.Array
        ) -> tuple[tuple[EnvState, Tally], Any]:
            state, happened = carry
            state, more = physics_tick(state, drivers, index, self.config, params)
            return (state, happened + more), self.probe(state) if self.probe else None

        ticks = self._first_tick(state) + jnp.arange(
            self.config.ticks_per_decision, dtype=jnp.int32
        )
        (state, happened), probed = jax.lax.scan(tick, (state, happened), ticks)

        happened = happened.replace(
            meds_dispatched=sent.astype(jnp.float32), invalid_actions=invalid.astype(jnp.float32)
        )
        state = self._advance_clock(state, params).replace(tally=state.tally + happened)
        outcome = Outcome(before, state, happened, params, self.config)
        with jax.named_scope("reward"):
            reward, terms = total_reward(outcome, self.reward)
        with jax.named_scope("metrics"):
            metrics = episode_metrics(state.tally)
        with jax.named_scope("observation"):
            obs = self.observation(state, self.config, params)
        truncated = state.time >= params.episode_decisions
        info = {
            "metrics": metrics,
            "reward_terms": terms,
            "action_mask": self.action_mask(state, params),
            "tally": happened,
            "begun": begun,
            "ticks": probed,
        }
        return obs, state, reward, jnp.zeros((), bool), truncated, info

    def action_mask(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Allowed actions, `(num_actions,)` bool; action 0 always is."""
        return action_mask(state, self.config)

    def observe(self, state: EnvState, params: EnvParams) -> Observation:
        """The structured observation: one row a MED, one an EV, and masks."""
        return observe(state, self.config, params)

    def render(self, state: EnvState, params: EnvParams | None = None, **size: int) -> Any:
        """Draws a state of one environment, `(height, width, 3)` uint8: `medjax.render.frame.render_state`."""
        from medjax.render.frame import render_state

        return render_state(state, self.config, params, name=self.name, **size)

    def _first_tick(self, state: EnvState) -> jax.Array | int:
        """Number of the decision's first tick, which says whose turn it is to change lanes.

        Where decisions are whole periods of the drivers' turns it is the same for all environments,
        and turns are slices of a batch, not gathers.
        """
        ticks = self.config.ticks_per_decision
        return 0 if ticks % (2 * self.config.lane_change_groups) == 0 else state.time * ticks

    def _book(self, state: EnvState, params: EnvParams) -> EnvState:
        """EVs low on energy ask the nearest MED in service."""
        config, vehicles, evs, meds = self.config, state.vehicles, state.evs, state.meds
        med_slots, ev_slots = config.med_slots, config.ev_slots
        length = by_kind(vehicle_kinds(evs.is_human, config), params.drivers.vehicle_length)
        booked = panel_flags(evs.med, evs.panel, evs.med != NOT_BOOKED, config.num_meds)
        offers = Offers(
            x=vehicles.x[med_slots],
            speed=vehicles.speed[med_slots],
            lane=vehicles.lane[med_slots],
            length=length[med_slots],
            free=can_serve(meds, params)[:, None] & ~booked,
        )
        cruise = jnp.asarray(params.drivers.desired_speed[AUTONOMOUS_EV])
        power = drive_energy(cruise, cruise, params.ev, 1.0)
        lane = vehicles.lane[ev_slots]
        requests = Requests(
            x=vehicles.x[ev_slots],
            lane=lane,
            length=length[ev_slots],
            asks=vehicles.active[ev_slots]
            & (lane < config.num_lanes)
            & (evs.med == NOT_BOOKED)
            & (evs.timer_s <= 0.0)
            & (evs.energy_j < params.charging.request_soc * params.ev_capacity_j),
            endurance_s=evs.energy_j / power,
        )
        med, panel = book(
            evs.med,
            evs.panel,
            requests,
            offers,
            params.road.length_m,
            config.num_lanes,
            params.charging,
        )
        return state.replace(evs=evs.replace(med=med, panel=panel))

    def _perturb(self, key: jax.Array, state: EnvState, params: EnvParams) -> EnvState:
        """Drivers' noise moves on once a decision; between decisions it is constant."""
        config, vehicles, drivers = self.config, state.vehicles, params.drivers
        kind = vehicle_kinds(state.evs.is_human, config)
        normal = jax.random.normal(key, (2, config.num_vehicles))
        time_s, dt = params.motion.noise_time_s, config.decision_s
        noise, wander = (
            ornstein_uhlenbeck(value, draw, by_kind(kind, std), time_s, dt)
            for value, draw, std in (
                (vehicles.acceleration_noise, normal[0], drivers.acceleration_noise),
                (vehicles.wander, normal[1], drivers.lateral_wander),
            )
        )
        return state.replace(vehicles=vehicles.replace(acceleration_noise=noise, wander=wander))

    def _advance_clock(self, state: EnvState, params: EnvParams) -> EnvState:
        """Counts the decision, lets the cooldown run, and brings MEDs back to the depot, full."""
        meds, dt = state.meds, self.config.decision_s
        ready_in = jnp.where(
            meds.status == RETIRED, count_down(meds.ready_in_s, dt), meds.ready_in_s
        )
        returns = (meds.status == RETIRED) & (ready_in <= 0.0)
        meds = meds.replace(
            status=jnp.where(returns, AT_DEPOT, meds.status),
            energy_j=jnp.where(returns, params.med_capacity_j, meds.energy_j),
            rest_j=jnp.where(returns, 0.0, meds.rest_j),
            ready_in_s=ready_in,
        )
        return state.replace(
            meds=meds,
            cooldown_s=count_down(state.cooldown_s, dt),
            time=state.time + 1,
        )
