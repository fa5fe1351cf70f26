"""The interface of `ChargingEnv` and of every wrapper, on which policies, players and learners rely.

Learners need fewer members: `tests/train/probe_envs.py` has minimal environments for them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax
from jax import Array
from jaxtyping import Bool, Float32

Observation = Any
State = Any
Params = Any
Info = dict[str, Any]
StepResult = tuple[
    Observation,
    State,
    Float32[Array, "*num_envs"],  # reward
    Bool[Array, "*num_envs"],  # terminated
    Bool[Array, "*num_envs"],  # truncated
    Info,
]


class Environment(Protocol):
    """One environment; the caller vectorises it with `jax.vmap`. Every method except `render` can be jitted.

    A state has `time`, () int32, the decisions taken so far.
    """

    @property
    def name(self) -> str:
        """Display name."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions; action 0 is always allowed."""

    @property
    def config(self) -> Any:
        """Sizes and time steps of the highway, `medjax.world.params.EnvConfig`."""

    @property
    def observation(self) -> Any:
        """The object that builds the vector of `get_obs`; networks read its layout."""

    @property
    def decisions_per_step(self) -> int:
        """Maximum number of highway decisions per step; `state.time` grows by the number taken."""

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode."""

    def step(self, key: jax.Array, state: State, action: jax.Array, params: Params) -> StepResult:
        """Takes one decision and resets in the same step when the episode ends; see `step_with_reset`."""

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision without reset: obs, state, reward, terminated, truncated, info.

        `info["metrics"]` maps names to float32 scalars that describe the episode so far. All other entries of
        `ChargingEnv` describe this step: sum `info["reward_terms"]` and `info["step_stats"]` over steps; axis 0 of
        `info["ticks"]` is the physics tick.
        """

    def action_mask(self, state: State, params: Params) -> Bool[Array, "num_actions"]:
        """True where the action is allowed."""

    def get_obs(self, state: State, params: Params) -> Observation:
        """The policy's observation of a state, as `reset` and `step_env` return it."""

    def observe(self, state: State, params: Params) -> Any:
        """The structured observation, `medjax.env.observation.Observation`."""

    def observation_space(self, params: Params) -> Any:
        """A space with the attribute `shape`."""

    def action_space(self, params: Params) -> Any:
        """A space with the attribute `n`."""

    def render(self, state: State, params: Params, **size: int) -> Any:
        """A picture of a state, `(height, width, 3)` uint8."""

    def highway(self, state: State, params: Params) -> tuple[Any, Any]:
        """`EnvState` and `EnvParams` of the highway, without wrappers; the parameters hold for the whole episode."""

    def with_probe(self, probe: Callable[[Any], Any] | None) -> Environment:
        """A copy that reports `probe(state)` of the highway after every tick in `info["ticks"]`."""


class BatchEnvironment(Protocol):
    """Copies of an environment that reset and step together; axis 0 is the environment."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""

    def reset(self, keys: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode in each copy, from keys `(num_envs,)`."""

    def step(self, keys: jax.Array, state: State, actions: jax.Array, params: Params) -> StepResult:
        """Takes one decision in every copy, from keys `(num_envs,)`; finished copies restart in the same step."""

    def action_mask(self, state: State, params: Params) -> Bool[Array, "num_envs num_actions"]:
        """True where the action is allowed."""


def step_with_reset(
    env: Environment, key: jax.Array, state: State, action: jax.Array, params: Params
) -> StepResult:
    """Takes one decision and resets in the same step when the episode ends, as gymnax 1.0 does.

    Returns:
      (observation, state, reward, terminated, truncated, info). After an episode's end, observation, state and
      `info["action_mask"]` belong to the next one. `info["final_observation"]` always precedes any reset.
    """
    step_key, reset_key = jax.random.split(key)
    last_obs, last_state, reward, terminated, truncated, info = env.step_env(
        step_key, state, action, params
    )
    ends = terminated | truncated
    # Unbatched, cond skips the reset. Under vmap both branches run; wrappers.BatchAutoReset avoids that.
    obs, state = jax.lax.cond(
        ends, lambda: env.reset(reset_key, params), lambda: (last_obs, last_state)
    )
    info = info | {"final_observation": last_obs, "action_mask": env.action_mask(state, params)}
    return obs, state, reward, terminated, truncated, info
