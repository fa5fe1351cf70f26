"""Records an episode at every physics tick as NumPy arrays. Pictures, players and exports read them.

`record_episode` returns a whole episode; `record_pieces` yields pieces of bounded size.
"""

import dataclasses
import functools
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from medjax.env.contract import Environment
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, Episodes, episode_decisions, episode_steps
from medjax.errors import renamed
from medjax.policies.policy import Policy
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, EpisodeStats

OF_VEHICLES = ("x", "speed", "lane", "lateral_offset", "lateral_speed", "active", "kind")
SLOTS_OF_A_PIECE = 1_000_000  # vehicle slots times frames in a piece: about 100 MB


class Frames(struct.PyTreeNode):
    """The road at F instants; V = num_vehicles, E = num_evs, M = num_meds, G = num_gas.

    A slot always belongs to one class of vehicles: `EnvConfig.med_slots` to MEDs, `ev_slots` to EVs, the rest to gas
    vehicles. It holds one vehicle after another, and `Recording.vehicle_ids` tells them apart. Where `active` is False,
    the slot's other values are undefined.
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
    ev_charging_slot: Any  # (F, E) int32, charging slot of that MED (`medjax.world.params.CHARGING_SLOTS`), -1 for none
    ev_is_charging: Any  # (F, E) bool
    med_soc: Any  # (F, M) state of charge, 0 to 1
    med_status: Any  # (F, M) int32, index into `medjax.world.state.STATUS_NAMES`
    med_depot: Any  # (F, M) int32, where it waits, or returns after leaving the road
    med_service_speed: Any  # (F, M) m/s, ordered service speed
    med_service_lane: Any  # (F, M) int32, ordered service lane
    med_accepts: Any  # (F, M) bool, accepts new bookings
    gas_is_broken_down: Any  # (F, G) bool, an incident makes it brake, then stand in its lane

    @property
    def ev_panel(self) -> Any:
        """Former name of `ev_charging_slot`; the next version drops it."""
        return renamed("Frames.ev_panel", "ev_charging_slot", self.ev_charging_slot)


class Decisions(struct.PyTreeNode):
    """Decisions and their outcomes; T decisions, A actions.

    With agents, this is the decision of one agent that could enter the road (`Decision.of_dispatcher`). `Frames` holds
    the orders to MEDs in service.
    """

    action: Any  # (T,) int32, as the policy chose; a masked action counts as 0
    sent: Any  # (T,) int32, the ramp from which a MED was sent, counted from 1; 0: none
    mask: Any  # (T, A) bool, allowed actions
    probabilities: Any  # (T, A) of the policy; 0 and 1 for a rule
    reward: Any  # (T,)
    reward_terms: dict[str, Any]  # (T,) each, weighted
    stats: EpisodeStats  # (T, ...) sums over the decision
    queue: Any  # (T, num_entries) int32, vehicles waiting at each entry after the decision
    cooldown_s: Any  # (T,) after the decision

    @property
    def tally(self) -> EpisodeStats:
        """Former name of `stats`; the next version drops it."""
        return renamed("Decisions.tally", "stats", self.stats)


@dataclasses.dataclass(frozen=True)
class Recording:
    """An episode of T decisions and F = 1 + T * ticks_per_decision frames; the first frame is the reset.

    A piece of an episode (`record_pieces`) starts with the last frame of the piece before. Frame
    `t * ticks_per_decision` shows the road at decision t, and the next `ticks_per_decision` frames show what follows.
    After the last decision there may be fewer frames, if a wrapper takes several highway decisions at once.
    """

    scenario: str
    policy: str
    seed: int
    episode: int
    config: EnvConfig
    params: EnvParams  # of the simulated highway; NumPy leaves
    frames: Frames
    decisions: Decisions
    ticks_per_decision: int
    first_frame: int = 0  # number of the first of `frames` in the episode
    # (V,) number of the latest vehicle in each slot at the first frame; None if that frame is the reset.
    numbered: np.ndarray | None = None

    @property
    def time_s(self) -> np.ndarray:
        """Time of each frame since the reset, (F,) s."""
        return (self.first_frame + np.arange(len(self.frames.x))) * self.config.tick_s

    @property
    def decision_frames(self) -> np.ndarray:
        """The frame of each decision, and the last frame, (T + 1,) int."""
        count = 1 + len(self.decisions.action)
        return np.minimum(np.arange(count) * self.ticks_per_decision, len(self.frames.x) - 1)

    def vehicle_ids(self) -> np.ndarray:
        """Number of the vehicle in each slot, (F, V) int64, in order of entry, then of slot; -1 if it is empty."""
        return np.where(self.frames.active, self.latest(), -1)

    def latest(self) -> np.ndarray:
        """Number of the present or last vehicle in each slot, (F, V) int64; -1 if there was none yet."""
        active = np.asarray(self.frames.active)
        numbered = np.full(active.shape[1], -1) if self.numbered is None else self.numbered
        before = np.zeros_like(active[:1]) if self.numbered is None else active[:1]
        # A slot stays empty for at least one frame between two vehicles, so `active` shows every entry.
        entered = active & ~np.concatenate([before, active[:-1]])
        # The highest number so far is in `numbered`, since its vehicle is still the latest in its slot.
        number = numbered.max() + np.cumsum(entered.ravel()).reshape(entered.shape)
        return np.maximum.accumulate(np.where(entered, number, numbered))


def record_episode(
    env: Environment,
    params: EnvParams,
    policy: Policy,
    *,
    name: str = "policy",
    seed: int = 0,
    episode: int = 0,
) -> Recording:
    """Plays one episode and records every physics tick.

    Args:
      env: a single environment, wrapped or not. The recording replaces its probe, if any.
      params: its parameters.
      policy: the dispatcher. Further calls with the same env and policy objects reuse the compiled program.
      name: of the policy.
      seed, episode: which episode to play, numbered as in `train.evaluate`.
    """
    pieces = list(record_pieces(env, params, policy, name=name, seed=seed, episode=episode))
    rest = [jax.tree.map(lambda leaf: leaf[1:], piece.frames) for piece in pieces[1:]]
    return dataclasses.replace(
        pieces[0],
        frames=_joined([pieces[0].frames, *rest]),
        decisions=_joined([piece.decisions for piece in pieces]),
    )


def record_pieces(
    env: Environment,
    params: EnvParams,
    policy: Policy,
    *,
    name: str = "policy",
    seed: int = 0,
    episode: int = 0,
) -> Iterator[Recording]:
    """Plays the same episode as `record_episode`, in pieces of bounded size, each only when the caller asks for it.

    Args: as in `record_episode`.

    Yields:
      Pieces in order of time.
    """
    config, steps = env.config, episode_steps(env, params)
    ticks_a_step = config.ticks_per_decision * env.decisions_per_step
    count = -(-steps * ticks_a_step * config.num_vehicles // SLOTS_OF_A_PIECE)
    steps_a_piece = -(-steps // count)
    begin, go_on = _programs(_Same(env), policy, steps_a_piece)
    begun, first, road = begin(episode_keys(seed, 1, episode), params)
    last, road = jax.device_get((first, road))
    frames_of_all, numbered = 1 + episode_decisions(params) * config.ticks_per_decision, None
    for start in range(0, steps, steps_a_piece):
        begun, made = go_on(policy.weights, begun, jnp.int32(start), params)
        ticks, decided = jax.device_get(made)
        # The last piece, or a last step of several decisions, may extend beyond the end of the episode.
        first_frame = start * ticks_a_step
        frames = jax.tree.map(partial(_after, most=frames_of_all - first_frame), last, ticks)
        piece = Recording(
            scenario=env.name,
            policy=name,
            seed=seed,
            episode=episode,
            config=config,
            params=road,
            frames=frames,
            decisions=jax.tree.map(lambda leaf, left=steps - start: leaf[:left], decided),
            ticks_per_decision=ticks_a_step,
            first_frame=first_frame,
            numbered=numbered,
        )
        yield piece
        last, numbered = jax.tree.map(lambda leaf: leaf[-1], frames), piece.latest()[-1]


class _Same:
    """Compares an environment by identity, because a custom one may hold arrays, which have no hash."""

    def __init__(self, env: Environment) -> None:
        self.env = env

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.env is other.env

    def __hash__(self) -> int:
        return id(self.env)


@functools.lru_cache(maxsize=8)
def _programs(same: _Same, policy: Policy, steps_a_piece: int) -> tuple[Any, Any]:
    """Jitted programs that start an episode and play a piece; all episodes of an environment and policy share them."""
    runner = EpisodeRunner(same.env.with_probe(lambda state: state), [policy])
    return jax.jit(partial(_begin, runner)), jax.jit(partial(_go_on, runner, steps_a_piece))


def _after(start: np.ndarray, rest: np.ndarray, most: int) -> np.ndarray:
    """Appends the frames of later decisions, `(decisions, ticks, ...)`, to a frame; keeps the first `most` frames."""
    return np.concatenate([start[None], rest.reshape(-1, *start.shape)])[:most]


def _joined(parts: list[Any]) -> Any:
    """Concatenates trees along axis 0."""
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *each: np.concatenate(each), *parts)


def _begin(
    runner: EpisodeRunner, key: jax.Array, params: Any
) -> tuple[Episodes, Frames, EnvParams]:
    """Resets one episode; returns it with its first frame and the highway's params."""
    begun = runner.start(key, params)
    state, road = runner.env.highway(_row(begun.state), runner.policies[0].params_transform(params))
    return begun, frame_of(state, road), road


def _go_on(
    runner: EpisodeRunner, steps: int, weights: Any, begun: Episodes, start: jax.Array, params: Any
) -> tuple[Episodes, tuple[Frames, Decisions]]:
    """Plays `steps` steps from number `start`; returns the episode, frames `(steps, ticks, ...)` and decisions."""
    numbers = runner.policies[0].params_transform(params)

    def decide(episodes: Episodes, number: jax.Array) -> tuple[Episodes, Any]:
        """Takes decision `number`; returns the episode, the frames of its ticks and its record."""
        episodes, rows = runner.decide(episodes, number, [weights], params)
        after, road = runner.env.highway(_row(episodes.state), numbers)
        made = _row(rows.of_dispatcher(runner.env.config.num_actions))
        stats = made.info["step_stats"]
        decision = Decisions(
            action=made.action,
            sent=jnp.where(stats.meds_dispatched > 0.0, made.action, 0),
            mask=made.mask,
            probabilities=made.probabilities,
            reward=made.reward,
            reward_terms=made.info["reward_terms"],
            stats=stats,
            queue=after.queue,
            cooldown_s=after.cooldown_s,
        )
        return episodes, (frame_of(made.info["ticks"], road), decision)

    return jax.lax.scan(decide, begun, start + jnp.arange(steps, dtype=jnp.int32))


def _row(rows: Any) -> Any:
    """The only row of a batch, without its axis."""
    return jax.tree.map(lambda leaf: leaf[0], rows)


def frame_of(state: EnvState, params: EnvParams) -> Frames:
    """The recorded part of a state, or of states along a leading axis of time."""
    evs, meds = state.evs, state.meds
    first_gas = meds.energy_j.shape[-1] + evs.energy_j.shape[-1]
    drives = jnp.zeros_like(state.vehicles.active[..., first_gas:])
    return Frames(
        **{name: getattr(state.vehicles, name) for name in OF_VEHICLES},
        ev_soc=evs.energy_j / params.ev_capacity_j,
        ev_med=evs.med,
        ev_charging_slot=evs.charging_slot,
        ev_is_charging=evs.is_charging,
        med_soc=meds.energy_j / params.med_capacity_j,
        med_status=meds.status,
        med_depot=meds.depot,
        med_service_speed=meds.service_speed,
        med_service_lane=meds.service_lane,
        med_accepts=meds.accepts,
        gas_is_broken_down=drives if state.stands_for_s is None else state.stands_for_s > 0.0,
    )
