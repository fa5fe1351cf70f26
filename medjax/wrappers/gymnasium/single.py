"""One highway as a Gymnasium environment, and the window for `render_mode="human"`."""

from typing import Any, ClassVar

import gymnasium
import jax
import numpy as np
from gymnasium.error import DependencyNotInstalled, ResetNeeded

from medjax.env.contract import Environment
from medjax.hooks import ENV_ID
from medjax.wrappers.gymnasium import programs


class ChargingGymEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One highway.

    `info["action_mask"]` `(num_actions,)` bool marks the actions allowed next; `action_masks()` returns the same for
    sb3-contrib. After a step, info also has "metrics" of the episode so far and "reward_terms", floats by name
    (`ChargingEnv.step_env`). A masked action counts as 0.

    Args:
      scenario: a name in `medjax.SCENARIOS`; None means "paper".
      render_mode: None, "rgb_array" or "human".
      env, params: an environment, possibly wrapped or user-defined, and its parameters, instead of a scenario.
      decide_every: decisions per step: first the action, then 0 (`DecideEvery`).
      **overrides: arguments of `medjax.make`.

    Raises:
      InputError: a scenario, option, value or render mode is not allowed.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["human", "rgb_array"],
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
        programs.check_render_mode(render_mode, self.metadata)
        self.simulator, self.params = programs.chosen(
            scenario, env, params, decide_every, overrides
        )
        self._program = programs.alike(self.simulator)
        self.observation_space, self.action_space = programs.spaces_of(self.simulator, self.params)
        self.render_mode = render_mode
        self._key: jax.Array | None = None
        self._state: Any = None
        self._window: Window | None = None

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
        self._show()
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
        self._show()
        return obs, reward, terminated, truncated, info

    def action_masks(self) -> np.ndarray:
        """Allowed actions, `(num_actions,)` bool; sb3-contrib expects this name."""
        if self._state is None:
            raise ResetNeeded("action_masks() before reset(): call reset() first")
        return np.array(programs.mask_one(self._program, self._state, self.params))

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Returns the road as `(H, W, 3)` uint8 if render_mode is "rgb_array"; "human" shows it in a window.

        Raises:
          gymnasium.error.DependencyNotInstalled: a library that draws or shows pictures is missing.
          gymnasium.error.ResetNeeded: there was no reset yet.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() draws nothing: make the environment with a render_mode")
            return None
        if self._state is None:
            raise ResetNeeded("render() before reset(): call reset() first")
        frame = programs.picture(self.simulator, self._state, self.params)
        if self.render_mode == "rgb_array":
            return frame
        self._window = self._window or Window(ENV_ID, self.metadata["render_fps"])
        self._window.show(frame)
        return None

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _show(self) -> None:
        """Shows the step in "human" mode, which Gymnasium expects without a call of `render`."""
        if self.render_mode == "human":
            self.render()


class Window:
    """A pygame window, as in Gymnasium's own environments; it opens with the first frame and takes its size.

    `show` waits so that at most `frames_per_s` are shown.

    Raises:
      gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, title: str, frames_per_s: float) -> None:
        try:
            import pygame
        except ImportError as error:
            remedy = 'pip install "gymnasium[classic-control]"'
            raise DependencyNotInstalled(f"pygame is not installed, run `{remedy}`") from error
        self._pygame: Any = pygame
        self._title, self._frames_per_s = title, frames_per_s
        self._clock = pygame.time.Clock()
        self._screen: Any = None

    def show(self, frame: np.ndarray) -> None:
        """Shows `(H, W, 3)` uint8, scaled to the size of the first frame."""
        pygame = self._pygame
        surface = pygame.surfarray.make_surface(frame.swapaxes(0, 1))
        if self._screen is None:
            pygame.display.init()
            pygame.display.set_caption(self._title)
            self._screen = pygame.display.set_mode(surface.get_size())
        pygame.transform.scale(surface, self._screen.get_size(), self._screen)
        pygame.event.pump()
        self._clock.tick(self._frames_per_s)
        pygame.display.flip()

    def close(self) -> None:
        """Closes the window; `show` opens it again."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
