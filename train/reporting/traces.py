"""Records whole episodes: the road in each round, and dispatches and need at each decision.

The episodes are those of `medjax.episodes.scores`, played by the same `EpisodeRunner`.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import lax
from tqdm import tqdm

from medjax.env.contract import Environment
from medjax.env.forecast import forecast_need
from medjax.env.observation import NEED_WINDOW_S
from medjax.episodes.keys import episode_keys
from medjax.episodes.runner import EpisodeRunner, Episodes, episode_decisions, episode_steps
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.numerics.rows import in_blocks
from medjax.policies.policy import Policy
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState

EPISODES_AT_ONCE = 32
BYTES_AT_ONCE = 2**28  # limit for traces


class Frame(struct.PyTreeNode):
    """The road at an instant. E = num_evs, M = num_meds."""

    ev_x: jax.Array  # (E,) m; the last position of an EV that is gone
    ev_soc: jax.Array  # (E,) state of charge
    ev_on_road: jax.Array  # (E,) bool
    med_x: jax.Array  # (M,) m
    med_on_road: jax.Array  # (M,) bool
    med_charges: jax.Array  # (M,) int32, number of EVs that the MED charges


class Trace(struct.PyTreeNode):
    """An episode of F rounds and T decisions of the policy, with R ramps; several episodes add leading axes.

    Vehicles enter at the start of a round, so a slot that empties in one is reused in the next at the earliest.
    """

    frames: Frame  # (F + 1, ...), the first after the reset, each other at the end of a round
    sent: jax.Array  # (T,) int32, ramp that a MED was sent from, counted from 1; 0: none
    need: jax.Array  # (T, R) EVs, `forecast_need` as policies see it, before the decision
    reward: jax.Array  # (T,)
    depleted: jax.Array  # (T,) EVs that ran out
    charging_stops: jax.Array  # (T,) EVs that broke off their trip to charge


def record(
    env: Environment, params: EnvParams, policies: Mapping[str, Policy], episodes: int, seed: int
) -> Iterator[Trace]:
    """Plays the first episodes of a seed with every policy, several at a time.

    Args:
        env: a single environment, wrapped or not.
        params: its parameters.
        policies: policies by name.
        episodes: whole episodes per policy.
        seed: selects the episodes.

    Yields:
        Traces of consecutive episodes, NumPy arrays `(episodes at once, policies, ...)`.
    """
    run = _recorder(env, policies, episode_decisions(params), episode_steps(env, params))
    weights = tuple(policy.weights for policy in policies.values())
    keys = episode_keys(seed, episodes)
    at_once = min(episodes, EPISODES_AT_ONCE)
    shapes = jax.eval_shape(run, weights, keys[:at_once], params)
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
    at_once = max(1, min(at_once, at_once * BYTES_AT_ONCE // size))
    for first in tqdm(range(0, episodes, at_once), "recording", disable=None, leave=False):
        # A fixed number of episodes lets one program serve; surplus ones are dropped.
        numbers = np.minimum(np.arange(first, first + at_once), episodes - 1)
        trace = jax.device_get(run(weights, keys[numbers], params))
        yield jax.tree.map(lambda leaf, left=episodes - first: leaf[:left], trace)


def _recorder(
    env: Environment, policies: Mapping[str, Policy], decisions: int, steps: int
) -> Callable[[Any, jax.Array, EnvParams], Trace]:
    """The jitted program `(weights, keys (episodes,), params) -> traces (episodes, policies, ...)`."""
    config = env.config
    runner = EpisodeRunner(env.with_probe(partial(_frame, config)), [*policies.values()])
    count, num_frames = len(runner.policies), 1 + decisions * config.rounds_per_decision
    ends = slice(config.ticks_per_round - 1, None, config.ticks_per_round)

    def play(keys: jax.Array, same: tuple[Any, EnvParams]) -> Trace:
        """Traces `(episodes * policies, ...)` of keys `(episodes,)`; same is (weights, params)."""
        weights, params = same

        def whole(state: Any, rounds: Frame) -> Frame:
            """Frames from the start on, with the EVs' energy in J converted to state of charge."""
            highway, numbers = env.highway(state, params)

            def joined(begin: jax.Array, rest: jax.Array) -> jax.Array:
                """The start before the rounds; the last step may cover decisions past the end of the episode."""
                return jnp.concatenate([begin[None], rest.reshape(-1, *begin.shape)])[:num_frames]

            frames = jax.tree.map(joined, _frame(config, highway), rounds)
            return frames.replace(ev_soc=frames.ev_soc / numbers.ev_capacity_j)

        def need_at(state: Any) -> jax.Array:
            highway, numbers = env.highway(state, params)
            return forecast_need(highway, config, numbers, NEED_WINDOW_S)

        def decide(episodes: Episodes, number: jax.Array) -> tuple[Episodes, Any]:
            """One decision, number () int32, of all episodes: (episodes, what a trace holds of it)."""
            after, made = runner.decide(episodes, number, weights, params)
            made = made.of_dispatcher(config.num_actions)
            step_stats = made.info["step_stats"]
            sent = jnp.where(step_stats.meds_dispatched > 0.0, made.action, 0)
            seen = jax.tree.map(lambda ticks: ticks[:, ends], made.info["ticks"])
            need = jax.vmap(need_at)(episodes.state)
            stopped = step_stats.charging_stops
            return after, (seen, sent, need, made.reward, step_stats.depleted, stopped)

        def to_end(first: Episodes) -> Trace:
            _, made = lax.scan(decide, first, jnp.arange(steps, dtype=jnp.int32))
            rounds, *decided = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), made)
            return Trace(jax.vmap(whole)(first.state, rounds), *decided)

        trace = in_blocks(to_end, runner.start(keys, params), group=count)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, count, *leaf.shape[1:]), trace)

    def run(weights: Any, keys: jax.Array, params: EnvParams) -> Trace:
        return on_devices(environment_mesh(keys.shape[0]), play)(keys, (weights, params))

    return jax.jit(run)


def _frame(config: EnvConfig, state: EnvState) -> Frame:
    """The recorded part of a state; `ev_soc` is still the energy in J."""
    vehicles, evs = state.vehicles, state.evs
    partner = evs.med[:, None] == jnp.arange(config.num_meds)
    return Frame(
        ev_x=vehicles.x[config.ev_slots],
        ev_soc=evs.energy_j,
        ev_on_road=vehicles.active[config.ev_slots],
        med_x=vehicles.x[config.med_slots],
        med_on_road=vehicles.active[config.med_slots],
        med_charges=jnp.sum(partner & evs.is_charging[:, None], axis=0, dtype=jnp.int32),
    )
