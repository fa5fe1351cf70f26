"""Many highways for Stable-Baselines3 in one compiled program; `make_vec_env` would step them one by one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from medjax.errors import InputError
from medjax.wrappers.gymnasium.vector import ChargingVectorEnv

Copies = int | Iterable[int] | None


class ChargingVecEnv(VecEnv):  # type: ignore[misc]
    """`ChargingVectorEnv` as a `VecEnv`, with action masks for sb3-contrib.

    When an episode ends, the observation is the first of the next one, and the copy's info holds
    "terminal_observation", "TimeLimit.truncated" and the episode's "metrics". Otherwise infos are empty, since filling
    a dict per copy and step would cost more than the step. `VecMonitor` records returns and lengths.

    Args:
      num_envs: copies, at least 1.
      **options: of `ChargingVectorEnv`.

    Raises:
      InputError: as in `ChargingVectorEnv`.
    """

    def __init__(self, num_envs: int, **options: Any) -> None:
        self.envs = ChargingVectorEnv(num_envs, **options)
        self.actions = np.zeros(num_envs, np.int64)
        spaces = self.envs.single_observation_space, self.envs.single_action_space
        super().__init__(num_envs, *spaces)

    def reset(self) -> np.ndarray:
        """Starts an episode in every copy, with the seeds if `seed` was called since the last reset."""
        obs, _ = self.envs.reset(seed=self._seeds)
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Stores the actions for `step_wait`."""
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Steps every copy; returns observations, rewards, dones and infos."""
        obs, rewards, terminated, truncated, seen = self.envs.step(self.actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for copy in np.flatnonzero(done):
            metrics = seen["final_info"]["metrics"]
            infos[copy] = {
                "terminal_observation": seen["final_obs"][copy],
                "TimeLimit.truncated": bool(truncated[copy] and not terminated[copy]),
                "metrics": {
                    name: float(values[copy])
                    for name, values in metrics.items()
                    if not name.startswith("_")
                },
            }
        return obs, rewards.astype(np.float32), done, infos

    def action_masks(self) -> np.ndarray:
        """Allowed actions, `(num_envs, num_actions)` bool."""
        return self.envs.action_masks()

    def get_images(self) -> Sequence[np.ndarray]:
        """Pictures of all copies, `(H, W, 3)` uint8 each, with `render_mode="rgb_array"`."""
        return self.envs.render() or ()

    def close(self) -> None:
        """Does nothing, since nothing is open."""

    def get_attr(self, attr_name: str, indices: Copies = None) -> list[Any]:
        """An attribute, once for each copy; all copies share it."""
        value = getattr(self if attr_name == "action_masks" else self.envs, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Copies = None) -> None:
        """Sets an attribute that all copies share.

        Raises:
          InputError: indices select only some copies.
        """
        if len(list(self._get_indices(indices))) < self.num_envs:
            raise InputError(f"{attr_name}: copies share it, allowed: set for all of them")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Copies = None, **options: Any
    ) -> list[Any]:
        """Calls a method of `ChargingVectorEnv`; returns its result for each copy."""
        given = getattr(self.envs, method_name)(*args, **options)
        return [given[copy] for copy in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Copies = None) -> list[bool]:
        """Always False: no copy has a Gymnasium wrapper."""
        return [False for _ in self._get_indices(indices)]
