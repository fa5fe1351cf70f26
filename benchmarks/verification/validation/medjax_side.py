"""medjax's trajectories: episodes side by side, every tick of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import medjax
from benchmarks.verification.validation.measures import find, summarise
from benchmarks.verification.validation.trajectories import Road, Trajectories
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.keys import episode_keys
from medjax.episodes.player import Episodes, Player
from medjax.world.kinds import GAS
from medjax.world.params import EnvParams
from medjax.world.state import EnvState

WARM_UP_MINUTES = 5  # until the road has filled
FASTEST = 80.0  # m/s; nobody drives so
SEEN = ("x", "speed", "lane", "lateral_offset", "active", "kind")

ParamsAt = Callable[[int], EnvParams]  # of a minute, from 0, the warm-up's among them


def _probe(state: EnvState) -> dict[str, jax.Array]:
    return {name: getattr(state.vehicles, name) for name in SEEN}


def trajectories(
    env: ChargingEnv, params_at: ParamsAt, episodes: int, minutes: int, seed: int, policy: str
) -> list[Trajectories]:
    """Plays whole minutes of episodes and keeps every tick.

    Args:
      env: the highway; its slots must suffice for the queues.
      params_at: parameters of each minute.
      episodes: side by side; minutes: of each; seed: whose episodes.
      policy: a name in `medjax.BASELINES`.
    """
    player = Player(env.with_probe(_probe), [medjax.BASELINES[policy](env)])
    decisions = round(60.0 / env.config.decision_s)
    weights = [player.policies[0].weights]

    @jax.jit
    def minute(playing: Episodes, number: Any, params: EnvParams) -> tuple[Episodes, Any]:
        def decide(playing: Episodes, index: jax.Array) -> tuple[Episodes, Any]:
            playing, made = player.decide(playing, index, weights, params)
            begun, ticks = made.info["begun"], made.info["ticks"]
            # Who has just entered is first seen where it entered, not after its first tick, which may end in
            # another lane; what the last tick leads to, the next decision begins with.
            frames = jax.tree.map(
                lambda first, rest: jnp.concatenate([first[:, None], rest[:, :-1]], 1), begun, ticks
            )
            return playing, frames

        return jax.lax.scan(decide, playing, number * decisions + jnp.arange(decisions))

    playing = player.start(episode_keys(seed, episodes), params_at(0))
    parts = []
    for number in range(minutes):
        playing, ticks = minute(playing, jnp.int32(number), params_at(number))
        parts.append(jax.device_get(ticks))  # each (decisions, episodes, ticks, N)
    params = params_at(0)
    return [
        of_slots(
            {name: _ticks([part[name][:, episode] for part in parts]) for name in SEEN},
            Road.of(env.config, params),
            env.config.tick_s,
            np.asarray(params.drivers.vehicle_length),
        )
        for episode in range(episodes)
    ]


def _ticks(parts: list[np.ndarray]) -> np.ndarray:
    """(ticks, N) of parts (decisions, ticks, N)."""
    return np.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])


def of_slots(
    slots: dict[str, np.ndarray], road: Road, tick_s: float, lengths: np.ndarray
) -> Trajectories:
    """Rows of vehicles from slots that hold one vehicle after the other.

    Args:
      slots: (ticks, N) by the names of SEEN.
      lengths: (num_kinds,) m.
    """
    by_slot = {name: values.T for name, values in slots.items()}  # rows by slot, then by tick
    rows = np.nonzero(by_slot["active"])
    slot, tick = (each.astype(np.int32) for each in rows)
    x, lane = by_slot["x"][rows].astype(float), by_slot["lane"][rows].astype(np.int32)
    # A slot that is filled anew at once is told by its place: no vehicle goes back, or as far in a tick.
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
        length=lengths[by_slot["kind"][rows]].astype(float),
        lateral=lane * road.lane_width_m + by_slot["lateral_offset"][rows],
    )


def measure(
    env: ChargingEnv,
    params: EnvParams,
    episodes: int = 4,
    minutes: int = 15,
    seed: int = 0,
    policy: str = "none",
) -> dict[str, Any]:
    """The figures of `measures.summarise` for one world, measured after WARM_UP_MINUTES.

    Args:
      env, params: of `medjax.make`; its slots must suffice for the queues (`num_gas=...`).
      episodes: side by side, in memory together; minutes: of each that are measured.
      policy: a name in `medjax.BASELINES`.
    """
    return summarise(observe(env, lambda _: params, episodes, minutes, seed, policy))


def observe(
    env: ChargingEnv,
    params_at: ParamsAt,
    episodes: int,
    minutes: int,
    seed: int,
    policy: str = "none",
) -> list[Any]:
    """`measures.find` of each episode after WARM_UP_MINUTES."""
    free_speed = float(params_at(0).drivers.desired_speed[GAS])
    played = trajectories(env, params_at, episodes, minutes + WARM_UP_MINUTES, seed, policy)
    measured = partial(find, free_speed=free_speed)
    return [measured(seen.after(60.0 * WARM_UP_MINUTES)) for seen in played]
