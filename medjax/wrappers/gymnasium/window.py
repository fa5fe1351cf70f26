"""A window that shows frames, by pygame, as Gymnasium's own environments have."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled


class Window:
    """Opens with the first frame, in its size.

    Args:
      title: of the window.
      frames_per_s: at most; `show` waits for as long as is left of a frame's time.

    Raises:
      gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, title: str, frames_per_s: float) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled(
                'pygame is not installed, run `pip install "gymnasium[classic-control]"`'
            ) from error
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
        """Closes it; `show` would open it again."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
