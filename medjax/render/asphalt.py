"""Draws what does not move: lanes, acceleration lanes, on-ramps, and a ruler."""

import numpy as np

from medjax.render import colors
from medjax.render.canvas import Canvas
from medjax.render.colors import Color
from medjax.render.layout import View
from medjax.render.roadway import Roadway

DASH_M, PERIOD_M = 6.0, 18.0  # lane markings, as on motorways
RULER_STEPS_M = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


def draw_asphalt(canvas: Canvas, view: View, road: Roadway, *, marked: bool) -> None:
    """Draws the road in a view, with lane markings if `marked`."""
    left, _, right, _ = view.box
    canvas.box(view.box, colors.GRASS)
    for ramp in road.ramp_x_m:
        _draw_ramp(canvas, view, road, ramp, marked=marked)
    start, end = max(left, view.px(0.0)), min(right, view.px(road.length_m))
    canvas.box((start, view.py(road.left_m), end, view.py(road.right_m)), colors.ASPHALT)
    if not marked:
        return
    first = np.floor(view.start_m / PERIOD_M) * PERIOD_M
    for lane in range(1, road.num_lanes):
        y_m = road.left_m + lane * road.lane_width_m
        for x in np.arange(first, view.start_m + view.span_m, PERIOD_M):
            dash = max(0.0, x), min(x + DASH_M, road.length_m)
            _draw_stripe(canvas, view, y_m, dash, colors.MARKING)
    for y_m in (road.left_m, road.right_m):
        _draw_stripe(canvas, view, y_m, (0.0, road.length_m), colors.EDGE)
    for ramp in road.ramp_x_m:  # the edge line is broken where vehicles may cross it
        merge = ramp, ramp + road.acceleration_lane_m
        _draw_stripe(canvas, view, road.right_m, merge, colors.ASPHALT)
        for x in np.arange(*merge, 0.5 * PERIOD_M):
            _draw_stripe(canvas, view, road.right_m, (x, x + 0.5 * DASH_M), colors.EDGE)


def _draw_stripe(
    canvas: Canvas, view: View, y_m: float, along_m: tuple[float, float], color: Color
) -> None:
    """Draws a line along the road."""
    left, _, right, _ = view.box
    y, (start, end) = view.py(y_m), map(view.px, along_m)
    canvas.box((max(left, start), y - 1, min(right, end), y + 1), color)


def _draw_ramp(canvas: Canvas, view: View, road: Roadway, ramp: float, *, marked: bool) -> None:
    """Draws an acceleration lane and its access road, which is not simulated."""
    left, _, right, bottom = view.box
    start, end = view.px(ramp), view.px(ramp + road.acceleration_lane_m)
    lane = road.lane_width_m * view.per_m
    run = (1.2 if marked else 0.4) * lane / 0.5
    if end < left or start - run > right:
        return
    top = view.py(road.right_m)
    access = [(start - run, bottom), (start, top), (start, top + lane)]
    canvas.polygon([*access, (start - 0.4 * run, bottom)], colors.ASPHALT)
    canvas.box((max(start, left), top - 1, min(end, right), top + lane), colors.ASPHALT)


def draw_ruler(canvas: Canvas, view: View, road: Roadway, font: int) -> None:
    """Draws a scale of metres along the road under a view."""
    left, _, right, bottom = view.box
    fits = [step for step in RULER_STEPS_M if step * view.along > 6.0 * font]
    step = fits[0] if fits else RULER_STEPS_M[-1]
    places = np.arange(np.ceil(view.start_m / step) * step, view.start_m + view.span_m + 1e-6, step)
    labels = [(view.px(x), f"{x:.0f} m") for x in places]
    for px, _ in labels:
        canvas.box((px - 0.5, bottom - 0.1 * font, px + 0.5, bottom + 0.25 * font), colors.EDGE)
    canvas.labels(labels, bottom + 0.9 * font, font, left + 0.5 * font, right - 0.5 * font)
