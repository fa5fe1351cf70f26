"""Pictures, videos and a player of one highway.

- `medjax.render.render_state`: one state as an RGB array (Pillow); `medjax.render.frame`.
- `medjax.render.video`: a recording as .mp4, .gif or .png (Pillow, and ffmpeg as imageio-ffmpeg brings it).
- `medjax.render.player`: a recording, or two side by side, as one HTML file that needs nothing else.
- `python -m medjax.render`: all three from a shell.

Nothing here is imported by `import medjax`, and no library beyond NumPy before it is needed.
"""

from __future__ import annotations

from typing import Any


class MissingLibrary(ImportError):
    """An optional library is not installed; the message says which, and the command that installs it."""

    def __init__(self, library: str) -> None:
        super().__init__(f'{library} is not installed: pip install "medjax[render]"')


def render_state(state: Any, config: Any, params: Any = None, **options: Any) -> Any:
    """Draws a state of one environment, `(height, width, 3)` uint8: `medjax.render.frame.render_state`.

    Raises:
      MissingLibrary: Pillow is not installed.
    """
    from medjax.render import frame  # what draws is an optional extra

    return frame.render_state(state, config, params, **options)
