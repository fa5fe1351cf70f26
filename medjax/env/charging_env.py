"""ChargingEnv: MEDs dispatched onto a highway to charge EVs as they drive.

The order within a decision is that of the paper's section "Experiment settings". `step` follows gymnax 1.0.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, Self

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float32

from medjax import hooks
from medjax.charging.booking import book, init_new_evs
from medjax.charging.link import Coupling, couple
from medjax.charging.plugs import charge_at_exits
from medjax.charging.range import apply_eco_speed
from medjax.env.carry import looked_up, packed, unpacked
from medjax.env.contract import StepResult, step_with_reset
from medjax.env.dispatch import action_mask, advance_clocks, dispatch
from medjax.env.metrics import episode_metrics
from medjax.env.observation import FlatObservation, check_observation, observe, of_shape
from medjax.env.reset import initial_state
from medjax.env.reward import TERMS, Outcome, RewardTerm, check_terms, total_reward
from medjax.env.spaces import Box, Discrete
from medjax.env.tick import distances_driven, means, physics_tick
from medjax.env.trips import plan_trips
from medjax.errors import InputError, shown
from medjax.numerics import loops
from medjax.traffic.entry import admit
from medjax.traffic.following import CarFollowing
from medjax.traffic.idm import IDM_PLUS
from medjax.traffic.incidents import break_down
from medjax.traffic.step import drivers_of, perturb
from medjax.world.checks import check_made_for
from medjax.world.params import EnvConfig, EnvParams, validate_config
from medjax.world.presets import Recipe
from medjax.world.state import EnvState, EpisodeStats

Driven = tuple[EnvState, EpisodeStats]
Carry = tuple[EnvState, jax.Array]  # of the loop over ticks: the state, and the sums as `(sums,)`


class ChargingEnv:
    """The MED dispatching problem on one highway.

    Every method is pure and works under `jax.jit`; batch with `jax.vmap` over keys, states, actions and params.


    Args:
      config: sizes and time steps; each config compiles its own program.
      reward: terms by name; `params.reward_weights` must hold a weight for each.
      observation: flat observation with `size(config)` and `__call__(state, config, params)`.
      name: shown in logs.
      following: the car-following model.
      coupling: the coil circuit: one of `medjax.charging.link.COUPLINGS`, or your own function.

    Attributes:
      recipe: how `medjax.make` was called; None if the environment was built directly.

    Raises:
      InputError: config is not an EnvConfig, a reward term is not a function, or the observation has no size.
    """

    decisions_per_step = 1
    recipe: Recipe | None = None

    def __init__(
        self,
        config: EnvConfig,
        reward: Mapping[str, RewardTerm] = TERMS,
        observation: Any = None,
        name: str = "charging",
        following: CarFollowing = IDM_PLUS,
        coupling: Coupling = couple,
    ) -> None:
        validate_config(config)
        check_terms(reward)
        self.config = config
        self.reward = dict(reward)
        self.observation = FlatObservation() if observation is None else observation
        check_observation(self.observation, config)
        self.name = name
        self.following = following
        self.coupling = coupling
        self.probe: Callable[[EnvState], Any] | None = None

    def __repr__(self) -> str:
        c = self.config
        slots = f"room for {c.num_meds} MEDs, {c.num_evs} EVs, {c.num_gas} others"
        return f"<{self.name}: {c.num_lanes} lanes, {c.num_ramps} ramps, {slots}; {c.decision_s:g} s a decision>"

    @property
    def num_actions(self) -> int:
        """`1 + num_ramps`: action 0 sends no MED, action r sends one from the r-th ramp."""
        return self.config.num_actions

    def action_space(self, params: EnvParams | None = None) -> Discrete:
        """Discrete(1 + num_ramps)."""
        return Discrete(self.num_actions)

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Unbounded float32 vector; docs/guide.md gives the range of each part."""
        return Box(-jnp.inf, jnp.inf, (self.observation.size(self.config),))

    def reset(self, key: jax.Array, params: EnvParams) -> tuple[Float32[Array, "size"], EnvState]:
        """Starts an episode on a road that already carries traffic.

        Returns:
          (observation, state)

        Raises:
          InputError: params were made for another config.
        """
        check_made_for(self.config, params)
        state = initial_state(key, self.config, params)
        return self.get_obs(state, params), state

    def step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> StepResult:
        """Takes one decision and resets in the same step when the episode ends; see `step_with_reset`."""
        return step_with_reset(self, key, state, action, params)

    def step_env(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> StepResult:
        """Takes one decision without resetting.

        Args:
          key: randomness of driver behaviour; `reset` has already drawn the arrivals.
          state: of one environment.
          action: () integer; an action that is out of range or masked becomes 0 and is counted in the metrics.

        Returns:
          (observation (size,) float32, state, reward () float32, terminated () bool, always False;
          truncated () bool, at params.episode_decisions; info with "metrics" of the episode so far,
          weighted "reward_terms", "action_mask", "step_stats" of this decision, probe outputs "begun" and "ticks")

        Raises:
          InputError: params were made for another config.
        """
        check_made_for(self.config, params)
        before = state
        with jax.named_scope("dispatch"):
            state, step_stats = dispatch(state, action, self.config, params)
        (state, step_stats), begun, ticks = self._rounds(key, state, step_stats, params)
        state, of_depots = advance_clocks(state, self.config, params)
        step_stats += of_depots
        state = state.replace(stats=state.stats + step_stats)
        outcome = Outcome(before, state, step_stats, params, self.config)
        with jax.named_scope("reward"):
            reward, terms = total_reward(outcome, self.reward)
        with jax.named_scope("metrics"):
            metrics = episode_metrics(state.stats)
        with jax.named_scope("observation"):
            obs = self.get_obs(state, params)
        truncated = state.time >= params.episode_decisions
        info = {
            "metrics": metrics,
            "reward_terms": terms,
            "action_mask": self.action_mask(state, params),
            "step_stats": step_stats,
            "tally": step_stats,  # its former name, for one more version
            "begun": begun,
            "ticks": ticks,
        }
        return obs, state, reward, jnp.zeros((), bool), truncated, info

    def _rounds(
        self, key: jax.Array, state: EnvState, step_stats: EpisodeStats, params: EnvParams
    ) -> tuple[Driven, Any, Any]:
        """Simulates a decision's rounds, which add to its statistics.

        Returns also the probe at each round's start and after each tick.
        """
        config = self.config
        rounds, ticks = config.rounds_per_decision, config.ticks_per_decision
        # One decision of n rounds then equals n decisions of one round that use the split keys.
        keys = jax.random.split(key, rounds) if rounds > 1 else key[None]
        indices = jnp.arange(ticks, dtype=jnp.int32).reshape(rounds, -1)
        first = state.time * rounds

        def play(carry: Driven, of_round: tuple[jax.Array, ...]) -> tuple[Driven, tuple[Any, Any]]:
            """One round."""
            (state, step_stats), (number, key, ticks) = carry, of_round
            state, entered = self._begin(key, state, first + number, params)
            begun = self.probe(state) if self.probe else None
            driven, seen = self._drive(state, step_stats + entered, ticks, params)
            return driven, (begun, seen)

        of_rounds = jnp.arange(rounds, dtype=jnp.int32), keys, self._first_tick(state) + indices
        driven, (begun, seen) = loops.scan(play, (state, step_stats), of_rounds)
        seen = jax.tree.map(lambda leaf: leaf.reshape(ticks, *leaf.shape[2:]), seen)
        return driven, begun, seen

    def _begin(
        self, key: jax.Array, state: EnvState, number: jax.Array, params: EnvParams
    ) -> Driven:
        """Starts a round: entries, trip plans, bookings and driver noise; `number` counts rounds since reset."""
        config = self.config
        with jax.named_scope("entry"):
            state, newcomers, entered = admit(state, number, config, params)
            evs = init_new_evs(state.evs, newcomers, config, params)
            state = state.replace(evs=evs)
        if config.num_exits:
            with jax.named_scope("trips"):
                state, rerouted = plan_trips(state, config, params)
                entered += rerouted
        if (stands_for_s := state.stands_for_s) is not None:
            with jax.named_scope("incidents"):
                stands_for_s = break_down(state, stands_for_s, number, config, params)
                state = state.replace(stands_for_s=stands_for_s)
        with jax.named_scope("booking"):
            state = state.replace(evs=book(state, config, params))
        with jax.named_scope("noise"):
            state = state.replace(vehicles=perturb(key, state.vehicles, config, params))
        return state, entered

    def _drive(
        self, state: EnvState, step_stats: EpisodeStats, ticks: jax.Array, params: EnvParams
    ) -> tuple[Driven, Any]:
        """Simulates a round's ticks; returns also the probe after each tick."""
        config = self.config
        drivers = drivers_of(apply_eco_speed(state, config, params), config, params)

        def tick(carry: Carry, index: jax.Array) -> tuple[Carry, Any]:
            """One physics tick, then the probe."""
            state, sums = carry
            state = unpacked(state)
            at_wheel = looked_up(drivers, state.vehicles.kind, params.drivers)
            state, more = physics_tick(
                state, at_wheel, index, config, params, self.following, self.coupling
            )
            seen = self.probe(state) if self.probe else None
            return (packed(state), sums + ravel_pytree(more)[0]), seen

        # One array, since a GPU would launch a program for each of the forty sums.
        sums, as_stats = ravel_pytree(step_stats)
        begun, before_s = packed(state), step_stats.ev_seconds
        (state, sums), seen = loops.scan(tick, (begun, sums), ticks)
        state, step_stats = unpacked(state), as_stats(sums)
        with jax.named_scope("tally"):
            driven = distances_driven(begun.vehicles, state.vehicles, config)
            seconds = step_stats.ev_seconds - before_s
            step_stats += driven + means(state, driven.ev_distance_m, seconds, config, params)
        if (free_in_s := state.plugs_free_in_s) is not None:
            with jax.named_scope("plugs"):
                state, at_plugs = charge_at_exits(state, free_in_s, config, params)
                step_stats += at_plugs
        return (state, step_stats), seen

    def action_mask(self, state: EnvState, params: EnvParams) -> Bool[Array, "num_actions"]:
        """Allowed actions; action 0 is always allowed."""
        return action_mask(state, self.config)

    def get_obs(self, state: EnvState, params: EnvParams) -> Float32[Array, "size"]:
        """The policy's observation of a state; InputError if it has another shape or type."""
        seen = self.observation(state, self.config, params)
        return of_shape(seen, (self.observation.size(self.config),))

    def observe(self, state: EnvState, params: EnvParams) -> Any:
        """The structured observation, `medjax.env.observation.Observation`."""
        return observe(state, self.config, params)

    def highway(self, state: EnvState, params: EnvParams) -> tuple[EnvState, EnvParams]:
        """State and params of the highway itself; wrappers strip their own additions."""
        return state, params

    def with_probe(self, probe: Callable[[EnvState], Any] | None) -> Self:
        """A copy of this environment that reports `probe(state)`; None removes the probe.

        `info["ticks"]`, `(ticks, ...)`, holds its value after every tick; `info["begun"]`, `(rounds, ...)`, at the
        start of each round, after new entries and bookings.


        Raises:
          InputError: probe is not a function.
        """
        if probe is not None and not callable(probe):
            raise InputError(f"probe is {shown(probe)}: allowed a function of the state, or None")
        probed = copy.copy(self)
        probed.probe = probe
        return probed

    def render(self, state: EnvState, params: EnvParams | None = None, **size: int) -> Any:
        """Draws a state of one environment, `(height, width, 3)` uint8; see `medjax.render.frame.render_state`."""
        return hooks.viewer(state, self.config, params, name=self.name, **size)

    def _first_tick(self, state: EnvState) -> jax.Array | int:
        """Number of the decision's first tick, which selects the group that may change lanes."""
        ticks = self.config.ticks_per_decision
        # If a decision covers whole cycles of the groups, a constant lets a batch select the group by slicing.
        return 0 if ticks % (2 * self.config.lane_change_groups) == 0 else state.time * ticks
