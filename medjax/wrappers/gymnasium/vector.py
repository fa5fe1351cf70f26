"""Many highways as a native vector environment of Gymnasium."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from medjax.env.contract import Environment
from medjax.env.wrapper import whole_number_of
from medjax.errors import InputError
from medjax.wrappers.auto_reset import BatchState
from medjax.wrappers.gymnasium import programs

# RecordEpisodeStatistics miscounts in SAME_STEP mode: findings/gymnasium-same-step-episode-lengths.sh.
COUNTS_WRONG = tuple(map(int, gymnasium.__version__.split(".")[:2])) < (1, 4)


class ChargingVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many highways, stepped by one compiled program.

    The autoreset mode is SAME_STEP: a copy whose episode ended returns the first observation of its next one.
    `infos["final_obs"]` and `infos["final_info"]` hold the end of the last one where `infos["_final_obs"]` is true.
    After `reset(seed=s)`, copy i plays the episode that `ChargingGymEnv.reset(seed=s + i)` starts.

    Args:
      num_envs: number of copies, at least 1.
      scenario, render_mode, env, params, decide_every, **overrides: as in `ChargingGymEnv`.

    Raises:
      InputError: a number, scenario, option, value or render mode is not allowed.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": programs.FRAMES_PER_S,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | None = None,
        render_mode: str | None = None,
        *,
        env: Environment | None = None,
        params: Any = None,
        decide_every: int = 1,
        **overrides: Any,
    ) -> None:
        whole_number_of("num_envs", num_envs, 1)
        programs.check_render_mode(render_mode)
        if COUNTS_WRONG:
            gymnasium.logger.warn(
                f"Gymnasium {gymnasium.__version__}: its vector RecordEpisodeStatistics leaves out the first decision "
                "of every later episode here; it is right from 1.4.0 on"
            )
        self.num_envs = num_envs
        self.simulator, self.params = programs.chosen(
            scenario, env, params, decide_every, overrides
        )
        self._program = programs.alike(self.simulator)
        spaces = programs.spaces_of(self.simulator, self.params)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(s, num_envs) for s in spaces)
        self.render_mode = render_mode
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]
        self._keys: jax.Array | None = None
        self._state: BatchState | None = None
        self._masks = np.ones((num_envs, self.simulator.num_actions), bool)

    def reset(  # type: ignore[override]
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode in every copy.

        Args:
          seed: copy i takes seed + i, or item i of a sequence; None continues with its generator.
          options: ignored.

        Returns:
          (observations (num_envs, size) float32, infos)
        """
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seed = [int(seed) + number for number in range(self.num_envs)]
        seeds = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"{len(seeds)} seeds: allowed {self.num_envs}, one per copy")
        for number, own in enumerate(seeds):
            if own is not None:
                self._generators[number] = seeding.np_random(own)[0]
        keys = programs.as_keys(np.stack([*map(programs.draw_words, self._generators)]))
        self._keys, self._state, result = programs.reset_all(self._program, keys, self.params)
        obs, info = programs.to_numpy(result)
        self._masks = info["action_mask"]
        return obs, _with_masks(info, np.ones(self.num_envs, bool))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Plays one step in every copy, with actions `(num_envs,)`.

        Raises:
          gymnasium.error.ResetNeeded: there was no reset yet.
          InputError: the shape of the actions is wrong, or an action is not an integer.
        """
        if self._keys is None:
            raise ResetNeeded("step() before reset(): call reset() first")
        given = programs.as_actions(actions, (self.num_envs,), self.simulator.num_actions)
        self._keys, self._state, result, final_obs = programs.step_all(
            self._program, self._keys, self._state, given, self.params
        )
        obs, reward, terminated, truncated, mask, info = programs.to_numpy(result)
        self._masks, done = mask, terminated | truncated
        going_on = {name: value for name, value in info.items() if name != "action_mask"}
        infos = _with_masks({"action_mask": mask}, np.ones(self.num_envs, bool))
        infos |= _with_masks(going_on, ~done)
        if done.any():
            last = np.full(self.num_envs, None, object)
            for number, own in zip(np.flatnonzero(done), np.array(final_obs)[done], strict=True):
                last[number] = own
            infos |= {"final_obs": last, "_final_obs": done.copy()}
            infos |= {"final_info": _with_masks(info, done), "_final_info": done.copy()}
        return obs, reward.astype(np.float64), terminated, truncated, infos

    def action_masks(self) -> np.ndarray:
        """Allowed actions, `(num_envs, num_actions)` bool."""
        return self._masks.copy()

    def render(self) -> tuple[np.ndarray, ...] | None:  # type: ignore[override]
        """Returns the road of every copy, each `(H, W, 3)` uint8, if render_mode is "rgb_array"."""
        if not programs.may_render(self.render_mode, self._state):
            return None
        assert self._state is not None
        states = jax.device_get(self._state.env)
        copies = (jax.tree.map(lambda leaf, i=i: leaf[i], states) for i in range(self.num_envs))
        return tuple(programs.picture(self.simulator, state, self.params) for state in copies)


def _with_masks(info: dict[str, Any], where: np.ndarray) -> dict[str, Any]:
    """Copies `info` in the form of Gymnasium's vector environments: entry `_name` masks the copies that have `name`.

    Args:
      info: arrays `(num_envs, ...)`, or dicts of them, by name.
      where: `(num_envs,)` bool, the copies that have the entries.
    """
    masked = {}
    for name, value in info.items():
        masked[name] = _with_masks(value, where) if isinstance(value, dict) else value.copy()
        masked[f"_{name}"] = where.copy()
    return masked
