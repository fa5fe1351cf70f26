"""What both Gymnasium environments run: compiled programs, spaces, randomness, and NumPy at the border.

Both split keys as `BatchAutoReset` does, so that one seed starts the same episode in either.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.spaces import Box, Discrete

from medjax.env.charging_env import ChargingEnv
from medjax.env.reward import RewardTerm
from medjax.errors import InputError
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.scenarios import make
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState
from medjax.wrappers.auto_reset import BatchAutoReset, BatchState

FRAMES_PER_S = 10  # a frame a decision: ten times true speed where a decision is a second

# Observations are scaled to about [-1, 1], without hard limits. Gymnasium's checker takes infinite bounds for a
# mistake, and what samples the space to try a network would overflow at the largest float.
BOUND = 1e6

REPORTED = ("action_mask", "metrics", "reward_terms")


def make_shared(scenario: str, overrides: Mapping[str, Any]) -> tuple[ChargingEnv, EnvParams]:
    """`medjax.make`, but one environment for all that are built alike: they share their compiled programs."""
    env, params = make(scenario, **overrides)
    parts = (env.config, tuple(env.reward.items()), env.observation, env.name)
    return (_shared(*parts) if isinstance(env.observation, Hashable) else env), params


@functools.lru_cache(maxsize=32)
def _shared(
    config: EnvConfig, reward: tuple[tuple[str, RewardTerm], ...], observation: Any, name: str
) -> ChargingEnv:
    return ChargingEnv(config, dict(reward), observation, name)


def spaces_of(env: ChargingEnv, params: EnvParams) -> tuple[Box, Discrete]:
    """Gymnasium's spaces of observations and actions."""
    seen = env.observation_space(params)
    low, high = max(seen.low, -BOUND), min(seen.high, BOUND)
    return Box(low, high, seen.shape, np.float32), Discrete(env.num_actions)


def check_render_mode(render_mode: str | None, metadata: Mapping[str, Any]) -> None:
    """Raises InputError with one line."""
    allowed = metadata["render_modes"]
    if render_mode is not None and render_mode not in allowed:
        raise InputError(f"render_mode = {render_mode!r}: allowed None, {', '.join(allowed)}")


def picture(env: ChargingEnv, state: EnvState, params: EnvParams) -> np.ndarray:
    """The road, `(H, W, 3)` uint8.

    Raises:
      gymnasium.error.DependencyNotInstalled: a library that draws is missing.
    """
    try:
        return np.asarray(env.render(state, params))
    except ImportError as error:
        raise DependencyNotInstalled(str(error)) from error


def draw_words(generator: np.random.Generator) -> np.ndarray:
    """Randomness of a key, (2,) uint32."""
    return generator.integers(2**32, size=2, dtype=np.uint32)


def as_keys(words: np.ndarray) -> jax.Array:
    """Keys `(...)` of words `(..., 2)` uint32, whatever generator JAX is set to."""
    return jax.random.wrap_key_data(jnp.asarray(words), impl="threefry2x32")


def to_numpy(tree: Any) -> Any:
    """Arrays as NumPy arrays of the caller's own, scalars as Python's."""
    host = jax.device_get(tree)
    return jax.tree.map(lambda leaf: leaf.item() if leaf.ndim == 0 else np.array(leaf), host)


@functools.partial(jax.jit, static_argnums=0)
def reset_one(env: ChargingEnv, key: jax.Array, params: EnvParams) -> Any:
    """(key, state, (observation, info)) of a new episode."""
    key, now = jax.random.split(key)
    obs, state = env.reset(jax.random.split(now)[0], params)
    return key, state, (obs, {"action_mask": env.action_mask(state, params)})


@functools.partial(jax.jit, static_argnums=0)
def step_one(
    env: ChargingEnv, key: jax.Array, state: EnvState, action: Any, params: EnvParams
) -> Any:
    """(key, state, (observation, reward, terminated, truncated, info)) after a decision."""
    key, now = jax.random.split(key)
    obs, state, *rest, info = env.step_env(jax.random.split(now)[0], state, action, params)
    return key, state, (obs, *rest, {name: info[name] for name in REPORTED})


@functools.partial(jax.jit, static_argnums=0)
def mask_one(env: ChargingEnv, state: EnvState, params: EnvParams) -> jax.Array:
    """Allowed actions, `(num_actions,)` bool."""
    return env.action_mask(state, params)


@functools.partial(jax.jit, static_argnums=0)
def reset_all(env: ChargingEnv, keys: jax.Array, params: EnvParams) -> Any:
    """`reset_one` for each of the keys `(num_envs,)`."""
    batch = BatchAutoReset(env)

    def start(keys: jax.Array, params: EnvParams) -> Any:
        later, now = _split(keys)
        obs, state = batch.reset(now, params)
        return later, state, (obs, {"action_mask": batch.action_mask(state, params)})

    return on_devices(environment_mesh(len(keys)), start)(keys, params)


@functools.partial(jax.jit, static_argnums=0)
def step_all(
    env: ChargingEnv, keys: jax.Array, state: BatchState, actions: Any, params: EnvParams
) -> Any:
    """A decision in every copy, and a new episode where one ended.

    Returns:
      (keys, state, (observation, reward, terminated, truncated, mask, info), final observation). Mask and observation
      fit the returned state; info and final observation are those that the decision led to.
    """
    batch = BatchAutoReset(env)

    def decide(rows: tuple[jax.Array, BatchState, Any], params: EnvParams) -> Any:
        keys, state, actions = rows
        later, now = _split(keys)
        obs, state, *rest, info = batch.step(now, state, actions, params)
        reported = {name: info[name] for name in REPORTED}
        mask = batch.action_mask(state, params)
        return later, state, (obs, *rest, mask, reported), info["final_observation"]

    return on_devices(environment_mesh(len(keys)), decide)((keys, state, actions), params)


def _split(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Two keys for each of `keys` `(num_envs,)`."""
    pairs = jax.vmap(jax.random.split)(keys)
    return pairs[:, 0], pairs[:, 1]
