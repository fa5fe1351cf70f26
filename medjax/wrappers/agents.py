"""`make_agents`: every MED is an agent, with an interface that JaxMARL's wrappers and learners accept directly.

Observations, actions and rewards are dicts by agent name, as in `MultiAgentEnv` of JaxMARL 0.2 (Rutherford et al. 2024,
arXiv:2311.10090). This module does not import JaxMARL.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from medjax.agents import SPEEDS, agents_of
from medjax.env.agents.environment import AgentsEnv
from medjax.env.spaces import Box, Discrete
from medjax.errors import InputError, shown
from medjax.world.params import EnvParams
from medjax.world.state import EnvState

Named = dict[str, Any]


def make_agents(
    name: str = "corridor",
    *,
    speeds: Sequence[float] = SPEEDS,
    credit: str = "team",
    **overrides: Any,
) -> NamedAgents:
    """Builds a preset in which every MED is an agent.

    A step is one decision of the preset, 10 s on `corridor`. If the preset decides more often than every 4 s, as
    `paper` does, several rounds form one decision of at least 4 s, and an episode has proportionally fewer decisions,
    unless `rounds_per_decision` or `episode_decisions` are given. Each MED of the fleet is one agent.

    Args:
      name: one of `medjax.SCENARIOS`.
      speeds: m/s, the choices of an agent in service; the fleet's service speed is added.
      credit: "team", everyone receives the reward of the preset; or "own", see `AgentsEnv`.
      **overrides: as in `medjax.make`.

    Raises:
      InputError: as in `medjax.make`, or a speed or credit is not allowed.
    """
    if reserved := sorted({"build", "central"} & overrides.keys()):
        raise InputError(f"unknown option {reserved[0]!r}: allowed those of medjax.make")
    return NamedAgents(*agents_of(name, speeds=speeds, credit=credit, **overrides))


class NamedAgents:
    """`AgentsEnv` bound to its params, with dicts by agent; methods work under `jax.jit` and `jax.vmap`.

    Args:
      env: of one highway.
      params: its parameters.

    Raises:
      InputError: env is not an `AgentsEnv`.

    Attributes:
      agents: names of the MEDs by slot, `med_0` and so on.
    """

    def __init__(self, env: AgentsEnv, params: EnvParams) -> None:
        if not isinstance(env, AgentsEnv):
            raise InputError(f"env is {shown(env)}: allowed one of agents, as make_agents gives it")
        self.env, self.params = env, params
        self.num_agents = env.num_agents
        self.agents = [f"med_{number}" for number in range(env.num_agents)]
        self._reset, self._step_env = jax.jit(env.reset), jax.jit(env.step_env)

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuilds copies from env and params, since compiled programs do not pickle."""
        return type(self), (self.env, self.params)

    def __repr__(self) -> str:
        return f"<{self.num_agents} agents of {self.name}, {self.env.num_actions} actions each>"

    @property
    def name(self) -> str:
        """Name of the preset."""
        return self.env.env.name

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """One class that holds all agents."""
        return {"med": list(self.agents)}

    @property
    def observation_spaces(self) -> Named:
        """A box for each agent."""
        return dict.fromkeys(self.agents, _as_theirs(self.env.observation_space()))

    @property
    def action_spaces(self) -> Named:
        """A discrete space for each agent."""
        return dict.fromkeys(self.agents, _as_theirs(self.env.action_space()))

    def reset(self, key: jax.Array) -> tuple[Named, EnvState]:
        """Starts an episode; returns observations `(size,)` float32 by agent, and the state."""
        obs, state = self._reset(key, self.params)
        return self._by_name(obs), state

    def step(
        self, key: jax.Array, state: EnvState, actions: Named, reset_state: EnvState | None = None
    ) -> tuple[Named, EnvState, Named, Named, Named]:
        """Takes one decision and, when the episode ends, resets in the same step, to `reset_state` if given.

        Returns:
          as in `step_env`; if the episode ended, observations and state belong to the next one.

        Raises:
          InputError: as in `step_env`.
        """
        key, reset_key = jax.random.split(key)
        obs, after, rewards, dones, infos = self.step_env(key, state, actions)
        first = (
            self.reset(reset_key)
            if reset_state is None
            else (self.get_obs(reset_state), reset_state)
        )
        either = functools.partial(jax.lax.select, dones["__all__"])
        obs, after = jax.tree.map(either, first, (obs, after))
        return obs, after, rewards, dones, infos

    def step_env(
        self, key: jax.Array, state: EnvState, actions: Named
    ) -> tuple[Named, EnvState, Named, Named, Named]:
        """Takes one decision without resetting.

        Args:
          key: randomness of driver behaviour.
          state: of one highway.
          actions: () integer for each agent, or (1,), as JaxMARL's learners pass it; a masked action counts as 0 and
            as invalid in the metrics.

        Returns:
          (observations, state, rewards () float32, dones () bool, infos). dones includes `__all__`. infos holds the
          metrics of the episode so far, `(num_agents,)` float32 each with equal entries, as JaxMARL's learners expect.

        Raises:
          InputError: an agent is missing or unknown, or an action is outside its space.
        """
        folded = jnp.stack(self._checked(actions)).astype(jnp.int32)
        obs, after, _, terminated, truncated, info = self._step_env(key, state, folded, self.params)
        done = terminated | truncated
        dones = dict.fromkeys([*self.agents, "__all__"], done)
        spread = (self.num_agents,)
        infos = {name: jnp.broadcast_to(x, spread) for name, x in info["metrics"].items()}
        return self._by_name(obs), after, self._by_name(info["rewards"]), dones, infos

    def get_obs(self, state: EnvState) -> Named:
        """Observations `(size,)` float32 by agent."""
        return self._by_name(self.env.get_obs(state, self.params))

    def get_avail_actions(self, state: EnvState) -> Named:
        """Allowed actions `(num_actions,)` bool by agent; action 0 is always allowed."""
        return self._by_name(self.env.action_mask(state, self.params))

    def world_state(self, state: EnvState) -> jax.Array:
        """Observation of the whole road for a central critic, `(G,)` float32."""
        return self.env.global_state(state, self.params)

    def observation_space(self, agent: str) -> Any:
        """The agent's box of float32.

        Raises:
          InputError: the agent is unknown.
        """
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Any:
        """The agent's discrete space.

        Raises:
          InputError: the agent is unknown.
        """
        return self.action_spaces[self._known(agent)]

    def _by_name(self, values: jax.Array) -> Named:
        """Splits axis 0 into a dict by agent."""
        return {agent: values[index] for index, agent in enumerate(self.agents)}

    def _known(self, agent: Any) -> str:
        if agent not in self.agents:
            raise InputError(f"agent {shown(agent)}: allowed {self._names()}")
        return str(agent)

    def _names(self) -> str:
        return f"{self.agents[0]} to {self.agents[-1]}" if self.agents else "none"

    def _checked(self, actions: Any) -> list[jax.Array]:
        """The actions, () each, in the order of the agents; values are checked only outside of jit."""
        if not isinstance(actions, Mapping):
            raise InputError(f"actions = {shown(actions)}: allowed an integer by agent")
        for agent in actions:
            self._known(agent)
        if missing := [agent for agent in self.agents if agent not in actions]:
            raise InputError(f"no action of {missing[0]}: allowed one of each of {self._names()}")
        checked = {agent: _as_array(actions[agent]) for agent in self.agents}
        for agent, value in checked.items():
            allowed = f"an integer from 0 to {self.env.num_actions - 1}"
            whole = value.shape in ((), (1,)) and jnp.issubdtype(value.dtype, jnp.integer)
            traced = isinstance(value, jax.core.Tracer)
            if not whole or not (traced or 0 <= value.item() < self.env.num_actions):
                raise InputError(f"action of {agent} = {shown(actions[agent])}: allowed {allowed}")
        return [jnp.asarray(value).reshape(()) for value in checked.values()]


def _as_array(given: Any) -> Any:
    """Keeps JAX arrays and converts anything else with NumPy, which never truncates a number."""
    if isinstance(given, jax.Array):
        return given
    try:
        return np.asarray(given)
    except Exception:  # ragged lists, or whatever a user's object raises
        return np.asarray(None)


def _as_theirs(space: Box | Discrete) -> Any:
    """Converts the space to JaxMARL's class if JaxMARL is imported, since its wrappers check classes."""
    theirs = sys.modules.get("jaxmarl.environments.spaces")
    if theirs is None:
        return space
    if isinstance(space, Discrete):
        return theirs.Discrete(space.n)
    return theirs.Box(space.low, space.high, space.shape)
