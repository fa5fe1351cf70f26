"""Pictures, videos and a player of one highway.

- `medjax.render.frame`: one instant as an RGB array (Pillow).
- `medjax.render.video`: a recording as .mp4, .gif or .png (Pillow, and ffmpeg as imageio-ffmpeg brings it).
- `medjax.render.player`: a recording, or two side by side, as one HTML file that needs nothing else.
- `python -m medjax.render`: all three from a shell.

Nothing here is imported by `import medjax`, and no library beyond NumPy before it is needed.
"""

from __future__ import annotations


class MissingLibrary(ImportError):
    """An optional library is not installed; the message says which, and the command that installs it."""

    def __init__(self, library: str) -> None:
        super().__init__(f'{library} is not installed: pip install "medjax[render]"')
