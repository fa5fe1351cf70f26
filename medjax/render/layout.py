"""Where the parts of a picture lie, for any size."""

from __future__ import annotations

import dataclasses

from medjax.errors import InputError
from medjax.render.roadway import Roadway

Box = tuple[float, float, float, float]  # px: left, top, right, bottom

SIZE = (1280, 480)  # px, default width and height
SMALLEST = (160, 120)  # px; below this not even the clock fits
LARGEST = 8192  # px
SPAN_M = (120.0, 400.0)  # default limits of the camera's stretch
EXAGGERATION = 1.6  # of the camera's lateral scale, where there is room


def check_size(width: int, height: int) -> None:
    """Raises InputError if a picture cannot have that size."""
    for name, value, low in zip(("width", "height"), (width, height), SMALLEST, strict=True):
        if not low <= value <= LARGEST:
            raise InputError(f"{name} = {value}: allowed {low} to {LARGEST} px")


def font_size(width: int, height: int) -> int:
    """Size of text for a picture, px."""
    return round(min(max(min(width / 70, height / 26), 9.0), 40.0))


@dataclasses.dataclass(frozen=True)
class View:
    """A window onto the road: metres to pixels."""

    box: Box
    start_m: float  # along the road, at the left edge
    span_m: float
    top_m: float  # across the road, at the upper edge
    per_m: float  # px per metre across the road

    def px(self, x_m: float) -> float:
        """The pixel column of a position along the road."""
        return self.box[0] + (x_m - self.start_m) * (self.box[2] - self.box[0]) / self.span_m

    def py(self, y_m: float) -> float:
        """The pixel row of a position across the road."""
        return self.box[1] + (y_m - self.top_m) * self.per_m

    @property
    def along(self) -> float:
        """Px per metre along the road."""
        return (self.box[2] - self.box[0]) / self.span_m


@dataclasses.dataclass(frozen=True)
class Layout:
    """Boxes in px, top to bottom."""

    font: int  # px
    header: Box
    strip: Box
    camera: Box
    legend: Box  # may be empty

    @classmethod
    def of(cls, width: int, height: int, legend_rows: int, font: int) -> Layout:
        """Divides a picture; the legend is dropped first if there is no room."""
        pad, line = round(0.5 * font), round(1.7 * font)
        legend = line * legend_rows if height > line * (legend_rows + 6) else 0
        top = line + pad // 2
        left = height - top - legend
        strip = round(min(0.42 * left, max(0.3 * left, 4.0 * line), 6.0 * line))
        return cls(
            font,
            header=(pad, 0, width - pad, top),
            strip=(pad, top, width - pad, top + strip),
            camera=(0, top + strip, width, height - legend),
            legend=(pad, height - legend, width - pad, height),
        )

    def strip_view(self, road: Roadway) -> View:
        """View of the whole road, with room for a line of text below."""
        left, top, right, bottom = self.strip
        bottom -= 1.3 * self.font
        top_m, height_m = _across(road)
        box = (left, top, right, bottom)
        return View(box, 0.0, road.length_m, top_m, (bottom - top) / height_m)

    def camera_view(self, road: Roadway, center_m: float, span_m: float | None) -> View:
        """View of a stretch around `center_m`, kept on the road, with room for a line of text below."""
        left, top, right, bottom = self.camera
        top, bottom = top + 0.6 * self.font, bottom - 1.8 * self.font
        top_m, height_m = _across(road)
        per_m = (bottom - top) / height_m
        if span_m is None:
            span_m = min(max((right - left) / per_m * EXAGGERATION, SPAN_M[0]), SPAN_M[1])
        span_m = min(span_m, road.length_m)
        # Otherwise a tall picture of a short stretch would draw cars as towers.
        limit = 3.0 * (right - left) / span_m
        if per_m > limit:
            spare = (per_m - limit) * height_m
            top, bottom = top + 0.5 * spare, bottom - 0.5 * spare
            per_m = limit
        start = min(max(center_m - 0.5 * span_m, 0.0), road.length_m - span_m)
        return View((left, top, right, bottom), start, span_m, top_m, per_m)


def _across(road: Roadway) -> tuple[float, float]:
    """Top and height of what must be visible across the road, m."""
    top = road.left_m - 0.25 * road.lane_width_m
    bottom = road.shoulder_m + 0.4 * road.lane_width_m
    return top, bottom - top
