"""One whole episode, every physics tick of it, as NumPy arrays: what pictures, players and exports are made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from medjax.env.charging_env import ChargingEnv
from medjax.episodes.keys import ACT, RESET, STEP, episode_keys
from medjax.policies.rules import Act
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, Tally

Choose = Callable[[jax.Array, jax.Array, EnvState, EnvParams], tuple[jax.Array, jax.Array]]
"""`(key, obs, state, params)` to an action `()` int32 and the probabilities `(num_actions,)` it was drawn with."""


class Frames(struct.PyTreeNode):
    """The road at F instants; V = num_vehicles, E = num_evs, M = num_meds.

    A slot belongs to one class for good (`EnvConfig.med_slots`, `ev_slots`, the rest gas) and to one vehicle after the
    other; `Recording.vehicle_ids` tells them apart. Where `active` is False the other numbers mean nothing.
    """

    x: Any  # (F, V) m, front bumper
    speed: Any  # (F, V) m/s
    lane: Any  # (F, V) int32, 0 leftmost; num_lanes is an acceleration lane
    lateral_offset: Any  # (F, V) m from the lane's centre, positive to the right
    lateral_speed: Any  # (F, V) m/s, positive to the right
    active: Any  # (F, V) bool, on the road
    kind: Any  # (F, V) int32 in `medjax.world.kinds.KINDS`
    ev_soc: Any  # (F, E) state of charge, 0 to 1
    ev_med: Any  # (F, E) int32, MED it is booked on, -1 for none
    ev_panel: Any  # (F, E) int32, slot of that MED (`medjax.world.params.PANELS`), -1 for none
    ev_is_charging: Any  # (F, E) bool
    med_soc: Any  # (F, M) state of charge, 0 to 1
    med_status: Any  # (F, M) int32, `medjax.world.state.AT_DEPOT` to `RETIRED`


class Decisions(struct.PyTreeNode):
    """What was decided, and what came of it; T decisions, A actions."""

    action: Any  # (T,) int32, as the policy chose; one that the mask forbids counts as 0
    sent: Any  # (T,) int32, the ramp that a MED was sent from, counted from 1; 0: none
    mask: Any  # (T, A) bool, allowed actions
    probabilities: Any  # (T, A) of the policy; a rule's are 0 and 1
    reward: Any  # (T,)
    reward_terms: dict[str, Any]  # (T,) each, weighted
    tally: Tally  # (T, ...) sums over the decision
    queue: Any  # (T, num_entries) int32, vehicles waiting at each entry after it
    cooldown_s: Any  # (T,) after it


@dataclasses.dataclass(frozen=True)
class Recording:
    """An episode of T decisions, F = 1 + T * ticks_per_decision frames; the first frame is that of the reset.

    Decision t is taken at frame `t * ticks_per_decision` and leads to the `ticks_per_decision` frames after it.
    """

    scenario: str
    policy: str
    seed: int
    episode: int
    config: EnvConfig
    params: EnvParams  # NumPy leaves
    frames: Frames
    decisions: Decisions

    @property
    def time_s(self) -> np.ndarray:
        """Time of each frame, (F,) s since the reset."""
        return np.arange(len(self.frames.x)) * self.config.tick_s

    def vehicle_ids(self) -> np.ndarray:
        """Who is in each slot, (F, V) int64: numbers in the order of entry, by slot within a frame; -1 for nobody."""
        active = np.asarray(self.frames.active)
        # A slot that empties is filled again one frame later at the earliest, so every entry is seen.
        entered = active & ~np.concatenate([np.zeros_like(active[:1]), active[:-1]])
        number = np.cumsum(entered.ravel()).reshape(entered.shape) - 1
        latest = np.maximum.accumulate(np.where(entered, number, -1), axis=0)
        return np.where(active, latest, -1)


def by_rule(act: Act, num_actions: int) -> Choose:
    """`act(key, state, params)`, as `medjax.policies.BASELINES` build it, for `record_episode`."""

    def choose(
        key: jax.Array, obs: jax.Array, state: EnvState, params: EnvParams
    ) -> tuple[jax.Array, jax.Array]:
        action = act(key, state, params)
        return action, jax.nn.one_hot(action, num_actions)

    return choose


def record_episode(
    env: ChargingEnv,
    params: EnvParams,
    choose: Choose,
    *,
    policy: str = "policy",
    seed: int = 0,
    episode: int = 0,
) -> Recording:
    """Plays one episode and keeps every physics tick.

    Args:
      env: a single environment; a probe of its own is replaced.
      params: its parameters.
      choose: the dispatcher; it is compiled with the environment.
      policy: its name.
      seed: whose episodes.
      episode: which of them; the same as in `train.evaluate`.
    """
    play = _player(env, choose, int(params.episode_decisions))
    key = episode_keys(seed, 1, episode)[0]
    first, ticks, decided = jax.device_get(jax.jit(play)(key, params))
    frames = jax.tree.map(
        lambda start, rest: np.concatenate([start[None], rest.reshape(-1, *start.shape)]),
        first,
        ticks,
    )
    return Recording(
        scenario=env.name,
        policy=policy,
        seed=seed,
        episode=episode,
        config=env.config,
        params=jax.device_get(params),
        frames=frames,
        decisions=decided,
    )


def _player(
    env: ChargingEnv, choose: Choose, decisions: int
) -> Callable[[jax.Array, EnvParams], tuple[Frames, Frames, Decisions]]:
    """The program `(key, params)` to the first frame, the others `(T, ticks, ...)`, and the decisions."""

    def play(key: jax.Array, params: EnvParams) -> tuple[Frames, Frames, Decisions]:
        """One episode."""

        def look(state: EnvState) -> Frames:
            return frame_of(state, params)

        probed = env.with_probe(look)
        streams = jax.random.split(key, 3)

        def decide(carry: tuple[jax.Array, EnvState], time: jax.Array) -> Any:
            """One decision."""
            obs, state = carry
            now = jax.vmap(jax.random.fold_in, (0, None))(streams, time)
            mask = probed.action_mask(state, params)
            action, probabilities = choose(now[ACT], obs, state, params)
            obs, state, reward, _, _, info = probed.step_env(now[STEP], state, action, params)
            happened = info["tally"]
            decision = Decisions(
                action=action,
                sent=jnp.where(happened.meds_dispatched > 0.0, action, 0),
                mask=mask,
                probabilities=probabilities,
                reward=reward,
                reward_terms=info["reward_terms"],
                tally=happened,
                queue=state.queue,
                cooldown_s=state.cooldown_s,
            )
            return (obs, state), (info["ticks"], decision)

        obs, state = probed.reset(streams[RESET], params)
        times = jnp.arange(decisions, dtype=jnp.int32)
        _, (ticks, decided) = jax.lax.scan(decide, (obs, state), times)
        return look(state), ticks, decided

    return play


def frame_of(state: EnvState, params: EnvParams) -> Frames:
    """What is kept of a state: one frame, without the axis of time."""
    vehicles, evs, meds = state.vehicles, state.evs, state.meds
    return Frames(
        x=vehicles.x,
        speed=vehicles.speed,
        lane=vehicles.lane,
        lateral_offset=vehicles.lateral_offset,
        lateral_speed=vehicles.lateral_speed,
        active=vehicles.active,
        kind=vehicles.kind,
        ev_soc=evs.energy_j / params.ev_capacity_j,
        ev_med=evs.med,
        ev_panel=evs.panel,
        ev_is_charging=evs.is_charging,
        med_soc=meds.energy_j / params.med_capacity_j,
        med_status=meds.status,
    )
