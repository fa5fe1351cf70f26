"""PettingZoo's parallel API of `medjax.make_agents`, for what does not know JAX."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from pettingzoo import ParallelEnv

from medjax.wrappers.agents import NamedAgents

# Its checkers take infinite bounds for a mistake; observations have none, and stay below some tens.
BOUND = 1e6


class ParallelAgents(ParallelEnv):  # type: ignore[misc]
    """Named agents, with NumPy at the border; `infos` have an agent's `action_mask` and the episode's metrics so far.

    An episode ends for all agents at once, by its time limit: a truncation.

    Args:
      env: of `medjax.make_agents`.
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
        """That of every agent."""
        return self._box

    def action_space(self, agent: str) -> Discrete:
        """An agent's own, so that each samples for itself."""
        return self._discrete[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode, that of the seed if there is one, else a new one; observations and infos by agent."""
        if seed is not None:
            self._key = jax.random.key(seed)
        self._key, key = jax.random.split(self._key)
        obs, self._state = self.env.reset(key)
        self.agents = list(self.possible_agents)
        return _own(obs), self._infos({})

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        """One decision.

        Returns:
          observations, rewards, terminations, truncations, infos, by agent

        Raises:
          gymnasium.error.ResetNeeded: no episode is under way.
          InputError: as `NamedAgents.step_env`.
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
    """Allowed actions by agent; a program of the module's, since one of an environment's would not pickle."""
    return env.get_avail_actions(state)


def _own(obs: dict[str, jax.Array]) -> dict[str, np.ndarray]:
    """Observations as the caller's, to keep or to change."""
    return {agent: np.array(values) for agent, values in obs.items()}
