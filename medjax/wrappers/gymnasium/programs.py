"""Shared by both Gymnasium environments: compiled programs, spaces, random keys and conversion to NumPy.

Both split keys as `BatchAutoReset` does, so a seed starts the same episode in either.
"""

import dataclasses
import functools
import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.spaces import Box, Discrete

from medjax.env.charging_env import ChargingEnv
from medjax.env.contract import Environment
from medjax.env.wrapper import check_environment, whole_number_of
from medjax.errors import InputError, shown
from medjax.numerics.devices import environment_mesh, on_devices
from medjax.scenarios import KEYWORDS, OPTIONS, check_names, make
from medjax.world.numbers import as_numbers
from medjax.wrappers.auto_reset import BatchAutoReset, BatchState, split_each
from medjax.wrappers.decide_every import DecideEvery

FRAMES_PER_S = 10  # one frame per decision: ten times real time if a decision takes 1 s

# Observations are unbounded, but stay below some tens. Gymnasium's checker warns about infinite bounds, and networks
# tested on samples of the space would overflow at the largest float.
BOUND = 1e6

# Keywords of the environments and of Gymnasium; a misspelt one arrives as an option of the scenario.
MEANT = (
    *("num_envs", "scenario", "render_mode", "env", "params", "decide_every"),
    *inspect.signature(gymnasium.make).parameters,
    *inspect.signature(gymnasium.make_vec).parameters,
)

REPORTED = ("action_mask", "metrics", "reward_terms")

_FIRST: dict[Any, Environment] = {}


def chosen(
    scenario: str | None,
    env: Environment | None,
    params: Any,
    decide_every: int,
    overrides: Mapping[str, Any],
) -> tuple[Environment, Any]:
    """Returns the given environment, or makes one, with its parameters.

    Raises:
      InputError: env is given with a scenario or without params; or as in `medjax.make` and `DecideEvery`.
    """
    check_names(overrides, (*OPTIONS, *KEYWORDS), MEANT)
    whole_number_of("decide_every", decide_every, 1)
    if env is not None:
        if scenario is not None or overrides or params is None:
            raise InputError("env: allowed with params, and without a scenario or its options")
        check_environment(env)
        if hasattr(env, "num_agents"):
            raise InputError(
                "env is of agents: allowed one of a dispatcher (make_agents is for agents)"
            )
    elif params is not None:
        raise InputError("params without env: allowed options of medjax.make by name")
    else:
        env, params = make("paper" if scenario is None else scenario, **overrides)
    return (env if decide_every == 1 else DecideEvery(env, decide_every)), params


def alike(env: Environment) -> Environment:
    """Returns the first environment that differs only in its numbers, so that both share one compiled program."""
    if type(env) is DecideEvery:
        return dataclasses.replace(env, env=alike(env.env))
    if type(env) is not ChargingEnv:
        return env
    own = env.observation, env.following, env.coupling, env.probe
    try:
        return _FIRST.setdefault((env.config, *env.reward.items(), env.name, *own), env)
    except TypeError:  # a user-defined part is not hashable
        return env


def spaces_of(env: Environment, params: Any) -> tuple[Box, Discrete]:
    """Gymnasium spaces of observations and actions."""
    seen = env.observation_space(params)
    bounds = np.float32(getattr(seen, "low", -BOUND)), np.float32(getattr(seen, "high", BOUND))
    low, high = (np.broadcast_to(np.clip(bound, -BOUND, BOUND), seen.shape) for bound in bounds)
    return Box(low, high, seen.shape, np.float32), Discrete(env.num_actions)


def check_render_mode(render_mode: str | None) -> None:
    """Raises InputError unless the environments support the render mode."""
    if render_mode not in (None, "rgb_array"):
        raise InputError(f"render_mode = {render_mode!r}: allowed None, rgb_array")


def may_render(render_mode: str | None, state: Any) -> bool:
    """Whether there is something to draw; raises ResetNeeded before the first reset."""
    if render_mode is None:
        gymnasium.logger.warn("render() draws nothing: make the environment with a render_mode")
    elif state is None:
        raise ResetNeeded("render() before reset(): call reset() first")
    return render_mode is not None


def picture(env: Environment, state: Any, params: Any) -> np.ndarray:
    """Picture of the road, `(H, W, 3)` uint8.

    Raises:
      gymnasium.error.DependencyNotInstalled: a drawing library is missing.
    """
    try:
        return np.asarray(env.render(state, params))
    except ImportError as error:
        raise DependencyNotInstalled(str(error)) from error


def as_actions(given: Any, shape: tuple[int, ...], num_actions: int) -> np.ndarray:
    """Converts actions of `shape` to int32.

    Raises:
      InputError: the shape differs, or a number is not an integer.
    """
    actions = as_numbers(given)
    if actions is None or actions.shape != shape or (actions != np.trunc(actions)).any():
        kind = "an integer" if shape == () else f"{shape[0]} integers in an array of shape {shape}"
        got = "" if actions is None else f" of shape {actions.shape}"
        allowed = f"allowed {kind}, each from 0 to {num_actions - 1}"
        raise InputError(f"action = {shown(given)}{got}: {allowed}")
    return np.clip(actions, -1, num_actions).astype(np.int32)


def draw_words(generator: np.random.Generator) -> np.ndarray:
    """Draws the words of a key, (2,) uint32."""
    return generator.integers(2**32, size=2, dtype=np.uint32)


def as_keys(words: np.ndarray) -> jax.Array:
    """Keys `(...)` from words `(..., 2)` uint32; independent of JAX's default generator."""
    return jax.random.wrap_key_data(jnp.asarray(words), impl="threefry2x32")


def to_numpy(tree: Any) -> Any:
    """Copies arrays to NumPy, and scalars to Python numbers."""
    host = jax.device_get(tree)
    return jax.tree.map(lambda leaf: leaf.item() if leaf.ndim == 0 else np.array(leaf), host)


@functools.partial(jax.jit, static_argnums=0)
def reset_one(env: Environment, key: jax.Array, params: Any) -> Any:
    """Starts an episode; returns (key, state, (observation, info))."""
    key, now = jax.random.split(key)
    obs, state = env.reset(jax.random.split(now)[0], params)
    return key, state, (obs, {"action_mask": env.action_mask(state, params)})


@functools.partial(jax.jit, static_argnums=0)
def step_one(env: Environment, key: jax.Array, state: Any, action: Any, params: Any) -> Any:
    """Plays a decision; returns (key, state, (observation, reward, terminated, truncated, info))."""
    key, now = jax.random.split(key)
    obs, state, *rest, info = env.step_env(jax.random.split(now)[0], state, action, params)
    info = {"action_mask": env.action_mask(state, params), **info}
    return key, state, (obs, *rest, reported(info))


def reported(info: Mapping[str, Any]) -> dict[str, Any]:
    """The entries that Gymnasium's users see; an environment of one's own may have fewer."""
    return {name: info[name] for name in REPORTED if name in info}


@functools.partial(jax.jit, static_argnums=0)
def mask_one(env: Environment, state: Any, params: Any) -> jax.Array:
    """Allowed actions, `(num_actions,)` bool."""
    return env.action_mask(state, params)


@functools.partial(jax.jit, static_argnums=0)
def reset_all(env: Environment, keys: jax.Array, params: Any) -> Any:
    """`reset_one` for each key `(num_envs,)`."""
    batch = BatchAutoReset(env)

    def start(keys: jax.Array, params: Any) -> Any:
        later, now = split_each(keys)
        obs, state = batch.reset(now, params)
        return later, state, (obs, {"action_mask": batch.action_mask(state, params)})

    return on_devices(environment_mesh(len(keys)), start)(keys, params)


@functools.partial(jax.jit, static_argnums=0)
def step_all(
    env: Environment, keys: jax.Array, state: BatchState, actions: Any, params: Any
) -> Any:
    """Plays a decision in every copy, and starts a new episode where one ended.

    Returns:
      (keys, state, (observation, reward, terminated, truncated, mask, info), final observation). Mask and observation
      belong to the returned state; info and final observation to the state before any reset.
    """
    batch = BatchAutoReset(env)

    def decide(rows: tuple[jax.Array, BatchState, Any], params: Any) -> Any:
        keys, state, actions = rows
        later, now = split_each(keys)
        obs, state, *rest, info = batch.step(now, state, actions, params)
        last = reported(info | {"action_mask": info["final_action_mask"]})
        return later, state, (obs, *rest, info["action_mask"], last), info["final_observation"]

    return on_devices(environment_mesh(len(keys)), decide)((keys, state, actions), params)
