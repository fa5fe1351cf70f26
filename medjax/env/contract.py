"""What an environment is, to whoever wraps it, acts in it, plays or shows its episodes, or learns from it.

`medjax.env.charging_env.ChargingEnv` is one, and so is each wrapper of one (`medjax.env.wrapper.Wrapper`): what takes
the one takes the other. Learners ask for less: `tests/train/probe_envs.py` has environments with the members that they
need.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax

Observation = Any
State = Any
Params = Any
Info = dict[str, Any]
StepResult = tuple[Observation, State, jax.Array, jax.Array, jax.Array, Info]


class Environment(Protocol):
    """One environment, written for a single episode and vectorised by the caller with `jax.vmap`.

    Its states have `time`, () int32: decisions taken in the episode. Every method but `render` is pure and jits.
    """

    @property
    def name(self) -> str:
        """Name for people."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions; action 0 is always allowed."""

    @property
    def config(self) -> Any:
        """Sizes and cadences of the highway, `medjax.world.params.EnvConfig`."""

    @property
    def observation(self) -> Any:
        """What makes the vector of `get_obs`: its layout, for networks that know it."""

    @property
    def decisions_per_step(self) -> int:
        """Decisions of the highway that a step takes, at most: `state.time` goes up by as many."""

    def reset(self, key: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode."""

    def step(self, key: jax.Array, state: State, action: jax.Array, params: Params) -> StepResult:
        """One decision, and a reset in the same step when the episode ends; see `step_with_reset`."""

    def step_env(
        self, key: jax.Array, state: State, action: jax.Array, params: Params
    ) -> StepResult:
        """One decision without reset: obs, state, reward, terminated, truncated, info.

        `info["metrics"]` maps names to float32 scalars describing the episode so far. What else `ChargingEnv` reports
        is of this step: `info["reward_terms"]` and `info["tally"]` add up over steps, `info["ticks"]` has an axis of
        the physics ticks first.
        """

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_actions,)` bool, True where the action is allowed."""

    def get_obs(self, state: State, params: Params) -> Observation:
        """What a policy sees of a state, as `reset` and `step_env` return it."""

    def observe(self, state: State, params: Params) -> Any:
        """The same in structured form, `medjax.env.observation.Observation`."""

    def observation_space(self, params: Params) -> Any:
        """A space with the attribute `shape`."""

    def action_space(self, params: Params) -> Any:
        """A space with the attribute `n`."""

    def render(self, state: State, params: Params, **size: int) -> Any:
        """A picture of a state, `(height, width, 3)` uint8."""

    def highway(self, state: State, params: Params) -> tuple[Any, Any]:
        """The road under any wrappers, as it is really simulated: its `EnvState` and its `EnvParams`.

        The parameters are those of the whole episode.
        """

    def with_probe(self, probe: Callable[[Any], Any] | None) -> Environment:
        """The same environment, which reports `probe(highway's state)` after every tick in `info["ticks"]`."""


class BatchEnvironment(Protocol):
    """Many copies of an environment that are reset and stepped together; axis 0 is the environment."""

    @property
    def num_actions(self) -> int:
        """Number of discrete actions."""

    def reset(self, keys: jax.Array, params: Params) -> tuple[Observation, State]:
        """Starts an episode in a copy for each of the keys `(num_envs,)`."""

    def step(self, keys: jax.Array, state: State, actions: jax.Array, params: Params) -> StepResult:
        """One decision in every copy, keys `(num_envs,)`; finished copies restart within the same step."""

    def action_mask(self, state: State, params: Params) -> jax.Array:
        """`(num_envs, num_actions)` bool, True where the action is allowed."""


def step_with_reset(
    env: Environment, key: jax.Array, state: State, action: jax.Array, params: Params
) -> StepResult:
    """One decision, and a reset in the same step when the episode ends: gymnax 1.0's step.

    Returns:
      (observation, state, reward, terminated, truncated, info). Observation and state are those
      of the next episode when this one ended; `info["final_observation"]` is always the
      observation that the decision itself led to. `info["action_mask"]` fits the returned state.
    """
    step_key, reset_key = jax.random.split(key)
    last_obs, last_state, reward, terminated, truncated, info = env.step_env(
        step_key, state, action, params
    )
    ends = terminated | truncated
    # Unbatched, cond spares the reset; under vmap both sides run (wrappers.BatchAutoReset).
    obs, state = jax.lax.cond(
        ends, lambda: env.reset(reset_key, params), lambda: (last_obs, last_state)
    )
    info = info | {
        "final_observation": last_obs,
        "action_mask": env.action_mask(state, params),
    }
    return obs, state, reward, terminated, truncated, info
