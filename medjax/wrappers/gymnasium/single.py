"""One highway as a Gymnasium environment."""

from typing import Any, ClassVar

import gymnasium
import jax
import numpy as np
from gymnasium.error import ResetNeeded

from medjax.env.contract import Environment
from medjax.wrappers.gymnasium import programs


class ChargingGymEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One highway.

    `info["action_mask"]` `(num_actions,)` bool marks the actions allowed next; `action_masks()` returns the same for
    sb3-contrib. After a step, info also has "metrics" of the episode so far and, if the environment reports them,
    "reward_terms", floats by name (`ChargingEnv.step_env`). A masked action counts as 0.
    `gymnasium.make(..., render_mode="human")` opens a window (`gymnasium.wrappers.HumanRendering`).

    Args:
      scenario: a name in `medjax.SCENARIOS`; None means "paper".
      render_mode: None or "rgb_array".
      env, params: an environment, possibly wrapped or user-defined, and its parameters, instead of a scenario.
      decide_every: decisions per step: first the action, then 0 (`DecideEvery`).
      **overrides: arguments of `medjax.make`.

    Raises:
      InputError: a scenario, option, value or render mode is not allowed.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": programs.FRAMES_PER_S,
    }

    def __init__(
        self,
        scenario: str | None = None,
        render_mode: str | None = None,
        *,
        env: Environment | None = None,
        params: Any = None,
        decide_every: int = 1,
        **overrides: Any,
    ) -> None:
        programs.check_render_mode(render_mode)
        self.simulator, self.params = programs.chosen(
            scenario, env, params, decide_every, overrides
        )
        self._program = programs.alike(self.simulator)
        self.observation_space, self.action_space = programs.spaces_of(self.simulator, self.params)
        self.render_mode = render_mode
        self._key: jax.Array | None = None
        self._state: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode. A seed fixes this episode and all later ones.

        Args:
          seed: None continues with the generator of the last seed.
          options: ignored.

        Returns:
          (observation (size,) float32, info)
        """
        super().reset(seed=seed)
        key = programs.as_keys(programs.draw_words(self.np_random))
        self._key, self._state, result = programs.reset_one(self._program, key, self.params)
        obs, info = programs.to_numpy(result)
        return obs, info

    def step(self, action: int | np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Plays one step.

        Raises:
          gymnasium.error.ResetNeeded: there was no reset yet.
          InputError: the action is not an integer.
        """
        if self._key is None:
            raise ResetNeeded("step() before reset(): call reset() first")
        given = programs.as_actions(action, (), self.simulator.num_actions)
        self._key, self._state, result = programs.step_one(
            self._program, self._key, self._state, given, self.params
        )
        obs, reward, terminated, truncated, info = programs.to_numpy(result)
        return obs, reward, terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Allowed actions, `(num_actions,)` bool; sb3-contrib expects this name."""
        if self._state is None:
            raise ResetNeeded("action_masks() before reset(): call reset() first")
        return np.array(programs.mask_one(self._program, self._state, self.params))

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Returns the road as `(H, W, 3)` uint8 if render_mode is "rgb_array".

        Raises:
          gymnasium.error.DependencyNotInstalled: Pillow is missing.
          gymnasium.error.ResetNeeded: there was no reset yet.
        """
        if not programs.may_render(self.render_mode, self._state):
            return None
        return programs.picture(self.simulator, self._state, self.params)
