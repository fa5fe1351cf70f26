"""PettingZoo's parallel API for `medjax.make_agents`, for code without JAX."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from pettingzoo import ParallelEnv

from medjax.wrappers.agents import NamedAgents

# PettingZoo's checks reject infinite bounds. Observations are unbounded, but stay below about a hundred.
BOUND = 1e6


class ParallelAgents(ParallelEnv):  # type: ignore[misc]
    """`NamedAgents` with NumPy arrays; `infos` hold each agent's `action_mask` and the episode's metrics so far.

    The time limit truncates an episode for all agents at once.

    Args:
      env: from `medjax.make_agents`.
    """

    def __init__(self, env: NamedAgents) -> None:
        self.env, self.possible_agents = env, list(env.agents)
        self.metadata = {"name": f"medjax_{env.name}", "is_parallelizable": True}
        self.render_mode = None
        self.agents: list[str] = []
        size = env.env.observation_space().shape
        self._box = Box(-BOUND, BOUND, size, np.float32)
        self._discrete: dict[str, Discrete] = {
            agent: Discrete(env.env.num_actions) for agent in env.agents
        }
        self._key = jax.random.key(int(np.random.SeedSequence().generate_state(1)[0]))
        self._state: Any = None

    def observation_space(self, agent: str) -> Box:
        """The space that all agents share."""
        return self._box

    def action_space(self, agent: str) -> Discrete:
        """The agent's own space, so that agents sample independently."""
        return self._discrete[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts the episode of the seed, or a new one without a seed; returns observations and infos by agent."""
        if seed is not None:
            self._key = jax.random.key(seed)
        self._key, key = jax.random.split(self._key)
        obs, self._state = self.env.reset(key)
        self.agents = list(self.possible_agents)
        return _own(obs), self._infos({})

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        """Takes one decision.

        Returns:
          observations, rewards, terminations, truncations, infos, by agent

        Raises:
          gymnasium.error.ResetNeeded: no episode is under way.
          InputError: as in `NamedAgents.step_env`.
        """
        if self._state is None:
            raise ResetNeeded("step() without an episode under way: call reset() first")
        self._key, key = jax.random.split(self._key)
        obs, self._state, rewards, dones, metrics = self.env.step_env(key, self._state, actions)
        over = bool(dones["__all__"])
        ended, cut = dict.fromkeys(self.agents, False), dict.fromkeys(self.agents, over)
        infos = self._infos({name: float(values[0]) for name, values in metrics.items()})
        paid = {agent: float(rewards[agent]) for agent in self.agents}
        if over:
            self.agents, self._state = [], None
        return _own(obs), paid, ended, cut, infos

    def _infos(self, metrics: dict[str, float]) -> dict[str, Any]:
        masks = jax.device_get(_masks(self.env, self._state))
        return {
            agent: {"action_mask": mask.astype(np.int8), "metrics": dict(metrics)}
            for agent, mask in masks.items()
        }


@functools.partial(jax.jit, static_argnums=0)
def _masks(env: NamedAgents, state: Any) -> dict[str, jax.Array]:
    """Allowed actions by agent; jitted at module level, since a compiled attribute would not pickle."""
    return env.get_avail_actions(state)


def _own(obs: dict[str, jax.Array]) -> dict[str, np.ndarray]:
    """Copies observations to NumPy arrays that the caller may keep and modify."""
    return {agent: np.array(values) for agent, values in obs.items()}
