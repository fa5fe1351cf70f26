"""Records medjax's trajectories: every tick of episodes that play side by side."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.verification.validation.demands import Schedule, free_speed
from benchmarks.verification.validation.measures import Findings, find
from benchmarks.verification.validation.trajectories import Bodies, Road, Trajectories
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, Episodes
from medjax.traffic.idm import IDM_PLUS, STANDARD_IDM
from medjax.world.params import EnvParams
from medjax.world.state import EnvState

# SUMO drives IDM, and medjax by default IDM+. So compare SUMO with `medjax IDM`.
MODELS = {"medjax": IDM_PLUS, "medjax IDM": STANDARD_IDM}
FASTEST = 80.0  # m/s, faster than any vehicle
SEEN = ("x", "speed", "lane", "lateral_offset", "active", "kind")


def _probe(state: EnvState) -> dict[str, jax.Array]:
    seen = {name: getattr(state.vehicles, name) for name in SEEN}
    return seen | {name: seen[name].astype(jnp.int8) for name in ("lane", "kind")}


@functools.lru_cache(maxsize=2)  # one program for each of MODELS; all demands share it
def program(env: ChargingEnv) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Two functions: one starts episodes, `(keys, params)`; one plays a minute, `(episodes, minute, params)`.

    The second one returns the episodes and their ticks, arrays `(decisions, episodes, ticks, N)` by the names of SEEN.
    """
    runner = EpisodeRunner(env.with_probe(_probe), [medjax.BASELINES["none"](env)])
    decisions = round(60.0 / env.config.decision_s)
    weights = [runner.policies[0].weights]

    def joined(begun: jax.Array, ticks: jax.Array) -> jax.Array:
        """Joins (episodes, rounds, N) and (episodes, ticks, N) to (episodes, ticks, N)."""
        rounds = ticks.reshape(*begun.shape[:2], -1, begun.shape[2])
        return jnp.concatenate([begun[:, :, None], rounds[:, :, :-1]], 2).reshape(ticks.shape)

    @jax.jit
    def minute(playing: Episodes, number: jax.Array, params: EnvParams) -> tuple[Episodes, Any]:
        def decide(playing: Episodes, index: jax.Array) -> tuple[Episodes, Any]:
            playing, made = runner.decide(playing, index, weights, params)
            begun, ticks = made.info["begun"], made.info["ticks"]
            # A new vehicle's first row must show where it entered, since its first tick may end in another lane. So the
            # rows of a round begin with the state at its start. They omit the state after its last tick, which the
            # start of the next round shows.
            return playing, jax.tree.map(joined, begun, ticks)

        return jax.lax.scan(decide, playing, number * decisions + jnp.arange(decisions))

    return jax.jit(runner.start), minute


def observe(env: ChargingEnv, schedule: Schedule, episodes: int, seed: int) -> list[Findings]:
    """Plays the schedule in episodes side by side and measures each after the warm-up."""
    speed = free_speed(schedule)
    return [find(seen, speed) for seen in record(env, schedule, episodes, seed)]


def record(
    env: ChargingEnv, schedule: Schedule, episodes: int, seed: int
) -> Iterator[Trajectories]:
    """Plays the schedule in episodes side by side and yields the trajectories of each after the warm-up."""
    params = schedule.params_at(0)
    start, minute = program(env)
    playing = start(episode_keys(seed, episodes), params)
    parts = []
    for number in range(schedule.all_minutes):
        playing, ticks = minute(playing, jnp.int32(number), schedule.params_at(number))
        if number >= schedule.warm_up_minutes:
            parts.append(jax.device_get(ticks))
    road, bodies = Road.of(env.config, params), Bodies.of(params)
    for episode in range(episodes):
        slots = {name: np.concatenate([part[name][:, episode] for part in parts]) for name in SEEN}
        slots = {name: seen.reshape(-1, seen.shape[-1]) for name, seen in slots.items()}
        yield trajectories_from_slots(slots, road, env.config.tick_s, bodies)


def trajectories_from_slots(
    slots: dict[str, np.ndarray], road: Road, tick_s: float, bodies: Bodies
) -> Trajectories:
    """Trajectories of vehicles from slots, each of which holds one vehicle after the other.

    `slots` holds arrays (ticks, N) by the names of SEEN.
    """
    by_slot = {name: values.T for name, values in slots.items()}  # rows by slot, then by tick
    rows = np.nonzero(by_slot["active"])
    slot, tick = (each.astype(np.int32) for each in rows)
    x, lane = by_slot["x"][rows].astype(float), by_slot["lane"][rows].astype(np.int32)
    # A jump shows that a new vehicle took the slot at once: no vehicle reverses or drives that far in a tick.
    new = (np.diff(slot) != 0) | (np.diff(tick) != 1)
    new |= (np.diff(x) < -1.0) | (np.diff(x) > FASTEST * tick_s)
    vehicle = np.r_[0, np.cumsum(new)].astype(np.int32)[: len(x)]
    return Trajectories(
        road=road,
        tick_s=tick_s,
        num_ticks=slots["x"].shape[0],
        tick=tick,
        vehicle=vehicle,
        lane=lane,
        x=x,
        speed=by_slot["speed"][rows].astype(float),
        length=bodies.length[by_slot["kind"][rows]],
        width=bodies.width[by_slot["kind"][rows]],
        lateral=lane * road.lane_width_m + by_slot["lateral_offset"][rows],
    )
