"""Whole episodes decision by decision: the road, the dispatches and the need for them.

The episodes are those of `train.evaluation.scores`: the same keys, and the same streams of randomness.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import lax
from tqdm import tqdm

from medjax.env.charging_env import ChargingEnv
from medjax.env.forecast import forecast_need
from medjax.env.observation import NEED_WINDOW_S
from medjax.episodes.keys import ACT, RESET, STEP, episode_keys
from medjax.numerics.rows import CACHED_ROWS
from medjax.world.params import EnvParams
from medjax.world.state import EnvState
from medjax.wrappers import environment_mesh, on_devices
from train.algorithms.environments import episode_decisions
from train.evaluation.scores import Policy, choose

EPISODES_AT_ONCE = 32
BYTES_AT_ONCE = 2**28  # of traces


class Frame(struct.PyTreeNode):
    """The road at an instant. E = num_evs, M = num_meds."""

    ev_x: jax.Array  # (E,) m; of an EV that is gone, where it was last
    ev_soc: jax.Array  # (E,) state of charge
    ev_on_road: jax.Array  # (E,) bool
    med_x: jax.Array  # (M,) m
    med_on_road: jax.Array  # (M,) bool
    med_charges: jax.Array  # (M,) int32, EVs that it charges


class Trace(struct.PyTreeNode):
    """An episode of T decisions with R ramps; several have their own axes first."""

    frames: Frame  # (T + 1, ...), the first is of the reset
    sent: jax.Array  # (T,) int32, the ramp that a MED was sent from, counted from 1; 0: none
    need: (
        jax.Array
    )  # (T, R) EVs, `forecast_need` over the window that policies see, before the decision
    reward: jax.Array  # (T,)
    depleted: jax.Array  # (T,) EVs that ran out


def record(
    env: ChargingEnv, params: EnvParams, policies: Mapping[str, Policy], episodes: int, seed: int
) -> Iterator[Trace]:
    """Plays the first episodes of a seed with every policy, some at a time.

    Args:
        env: a single environment.
        params: its parameters.
        policies: by name.
        episodes: whole episodes per policy.
        seed: which episodes.

    Yields:
        Traces of NumPy arrays `(episodes at once, policies, ...)`, of consecutive episodes.
    """
    run = _recorder(env, policies, episode_decisions(params))
    weights = tuple(policy.weights for policy in policies.values())
    keys = episode_keys(seed, episodes)
    at_once = min(episodes, EPISODES_AT_ONCE)
    shapes = jax.eval_shape(run, weights, keys[:at_once], params)
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
    at_once = max(1, min(at_once, at_once * BYTES_AT_ONCE // size))
    for first in tqdm(range(0, episodes, at_once), "recording", disable=None, leave=False):
        # Always as many, so that one program serves; episodes too many are thrown away.
        numbers = np.minimum(np.arange(first, first + at_once), episodes - 1)
        trace = jax.device_get(run(weights, keys[numbers], params))
        yield jax.tree.map(lambda leaf, left=episodes - first: leaf[:left], trace)


def _recorder(
    env: ChargingEnv, policies: Mapping[str, Policy], decisions: int
) -> Callable[[Any, jax.Array, EnvParams], Trace]:
    """The jitted program `(weights, keys (episodes,), params) -> traces (episodes, policies, ...)`."""
    acts: list[Callable[..., Any]] = [
        jax.vmap(policy.act, (None, 0, 0, 0, 0, None)) for policy in policies.values()
    ]
    over_rows = (0, None)
    step_all = jax.vmap(env.step_env, (0, 0, 0, None))

    def play(keys: jax.Array, same: tuple[Any, EnvParams]) -> Trace:
        """Traces of some episodes; a row of the batch plays one episode with one policy."""
        weights, params = same
        streams = jnp.repeat(jax.vmap(jax.random.split, over_rows)(keys, 3), len(acts), axis=0)
        look = jax.vmap(lambda state: _frame(state, env, params))
        need = jax.vmap(lambda state: forecast_need(state, env.config, params, NEED_WINDOW_S))

        def decide(carry: tuple[Any, EnvState], time: jax.Array) -> tuple[Any, Any]:
            """One decision in every row."""
            obs, state = carry
            now = jax.vmap(jax.vmap(jax.random.fold_in, over_rows), over_rows)(streams, time)
            mask = jax.vmap(env.action_mask, over_rows)(state, params)
            action = choose(acts, weights, (now[:, ACT], obs, state, mask), params)
            obs, after, reward, _, _, info = step_all(now[:, STEP], state, action, params)
            happened = info["tally"]
            sent = jnp.where(happened.meds_dispatched > 0.0, action, 0)
            return (obs, after), (look(after), sent, need(state), reward, happened.depleted)

        obs, state = jax.vmap(env.reset, over_rows)(streams[:, RESET], params)
        times = jnp.arange(decisions, dtype=jnp.int32)
        _, (frames, *decided) = lax.scan(decide, (obs, state), times)
        frames = jax.tree.map(
            lambda first, rest: jnp.concatenate([first[None], rest]), look(state), frames
        )
        return jax.tree.map(
            lambda leaf: jnp.moveaxis(leaf, 1, 0).reshape(
                -1, len(acts), len(leaf), *leaf.shape[2:]
            ),
            Trace(frames, *decided),
        )

    def run(weights: Any, keys: jax.Array, params: EnvParams) -> Trace:
        episodes_at_once = max(1, CACHED_ROWS // len(acts))
        shared = on_devices(environment_mesh(keys.shape[0]), play, episodes_at_once)
        return shared(keys, (weights, params))

    return jax.jit(run)


def _frame(state: EnvState, env: ChargingEnv, params: EnvParams) -> Frame:
    """What is recorded of a state."""
    config, vehicles, evs = env.config, state.vehicles, state.evs
    partner = evs.med[:, None] == jnp.arange(config.num_meds)
    return Frame(
        ev_x=vehicles.x[config.ev_slots],
        ev_soc=evs.energy_j / params.ev_capacity_j,
        ev_on_road=vehicles.active[config.ev_slots],
        med_x=vehicles.x[config.med_slots],
        med_on_road=vehicles.active[config.med_slots],
        med_charges=jnp.sum(partner & evs.is_charging[:, None], axis=0, dtype=jnp.int32),
    )
