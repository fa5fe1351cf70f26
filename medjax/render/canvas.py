"""A picture under construction: antialiased shapes with crisp text on top, in pixels of the result."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from medjax.errors import MissingLibrary
from medjax.render.colors import FAINT_INK, Color
from medjax.render.layout import Box

try:
    from PIL import Image, ImageDraw, ImageFont
except ImportError:
    raise MissingLibrary("Pillow") from None

Points = Sequence[tuple[float, float]]  # px

FINE = 2  # supersampling factor: Pillow's own edges are jagged


@functools.cache
def _font(size: int) -> Any:
    """Pillow's bundled font, so that pictures look the same on every machine."""
    return ImageFont.load_default(size)


def text_width(text: str, size: int) -> float:
    """Width of a line of text, px."""
    return float(_font(size).getlength(text))


class Canvas:
    """A picture that draws shapes at once, and text when it is finished."""

    def __init__(self, width: int, height: int, background: Color) -> None:
        self.width, self.height = width, height
        self._image = Image.new("RGB", (width * FINE, height * FINE), background)
        self._draw = ImageDraw.Draw(self._image)
        self._texts: list[tuple[float, float, str, int, Color, str]] = []

    def box(
        self, box: Box, fill: Color | None, outline: Color | None = None, line: float = 1.0
    ) -> None:
        """Draws a rectangle; `line` is the width of its outline, which lies inside."""
        left, top, right, bottom = (value * FINE for value in box)
        if right - left < 1.0 or bottom - top < 1.0:
            return
        corners = (round(left), round(top), round(right) - 1, round(bottom) - 1)
        self._draw.rectangle(corners, fill, outline, max(1, round(line * FINE)))

    def body(self, box: Box, slope: tuple[float, float], fill: Color, outline: Color) -> None:
        """Draws a vehicle that drives to the right, seen from above, with a window in the outline's colour.

        Args:
          box: its outline before it is turned.
          slope: shear of the turn: px down for each px of length, and px along for each px of width.
          fill: colour of the body.
          outline: colour of the outline.
        """
        left, top, right, bottom = (round(value * FINE) for value in box)
        width, height = right - left - 1, bottom - top - 1
        if width < 1 or height < 1:
            return

        def place(x: float, y: float) -> tuple[float, float]:
            """Maps a point given from the body's middle to the canvas."""
            middle = left + 0.5 * width, top + 0.5 * height
            return middle[0] + x + slope[1] * y, middle[1] + slope[0] * x + y

        radius = 0.22 * height
        outside = []
        for side, end, start in ((1, 1, 0.0), (-1, 1, 0.5), (-1, -1, 1.0), (1, -1, 1.5)):
            for turn in (start + np.linspace(0.0, 0.5, 5)) * np.pi:
                x = side * (0.5 * width - radius) + radius * np.cos(turn)
                y = end * (0.5 * height - radius) + radius * np.sin(turn)
                outside.append(place(x, y))
        self._draw.polygon(outside, fill, outline, FINE)
        if height > 8 * FINE:
            back, front = (0.5 * width - share * height for share in (0.28, 0.14))
            half = 0.34 * height
            corners = ((back, -half), (front, -half), (front, half), (back, half))
            self._draw.polygon([place(*corner) for corner in corners], outline)

    def line(self, points: Points, color: Color, width: float) -> None:
        """Draws a line through points."""
        fine = [(x * FINE, y * FINE) for x, y in points]
        self._draw.line(fine, color, max(1, round(width * FINE)), joint="curve")

    def dashes(self, ends: Points, color: Color, width: float, on: float, off: float) -> None:
        """Draws a dashed line."""
        (x0, y0), (x1, y1) = ends
        length = max(np.hypot(x1 - x0, y1 - y0), 1e-6)
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        for begin in np.arange(0.0, length, on + off):
            dash = (begin, min(begin + on, length))
            self.line([(x0 + ux * at, y0 + uy * at) for at in dash], color, width)

    def polygon(self, points: Points, fill: Color) -> None:
        """Draws a filled polygon."""
        self._draw.polygon([(x * FINE, y * FINE) for x, y in points], fill)

    def cross(self, x: float, y: float, radius: float, color: Color, width: float) -> None:
        """Draws an x."""
        for dy in (-radius, radius):
            self.line([(x - radius, y - dy), (x + radius, y + dy)], color, width)

    def text(
        self, x: float, y: float, text: str, size: int, color: Color, anchor: str = "lm"
    ) -> None:
        """Adds a line of text; `anchor` is Pillow's: l, m or r across, then a, m or s down."""
        self._texts.append((x, y, text, size, color, anchor))

    def labels(
        self, places: Sequence[tuple[float, str]], y: float, size: int, left: float, right: float
    ) -> None:
        """Adds faint texts centred at `(x, text)`, from left to right, and drops those without room."""
        free = left
        for place, text in places:
            half = 0.5 * text_width(text, size)
            x = min(max(place, left + half), right - half)
            if x - half >= free and abs(x - place) <= half + 1.0:
                self.text(x, y, text, size, FAINT_INK, "mm")
                free = x + half + size

    def finish(self) -> np.ndarray:
        """The picture, `(height, width, 3)` uint8."""
        image = self._image.reduce(FINE)
        draw = ImageDraw.Draw(image)
        for x, y, text, size, color, anchor in self._texts:
            draw.text((round(x), round(y)), text, color, _font(size), anchor)
        return np.asarray(image)
