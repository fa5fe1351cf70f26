"""What does not move: lanes, acceleration lanes, the ramps that lead to them, and a ruler."""

from __future__ import annotations

import numpy as np

from medjax.render import colors
from medjax.render.canvas import Canvas
from medjax.render.layout import View
from medjax.render.roadway import Roadway

DASH_M, PERIOD_M = 6.0, 18.0  # of lane markings, as on motorways
RULER_STEPS_M = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


def draw_asphalt(canvas: Canvas, view: View, road: Roadway, *, marked: bool) -> None:
    """Draws the road in a view; `marked` adds lane markings."""
    left, _, right, _ = view.box
    canvas.box(view.box, colors.GRASS)
    start, end = max(left, view.px(0.0)), min(right, view.px(road.length_m))
    for ramp in road.ramp_x_m:
        _draw_ramp(canvas, view, road, ramp, marked=marked)
    canvas.box((start, view.py(road.left_m), end, view.py(road.right_m)), colors.ASPHALT)
    if not marked:
        return
    first = np.floor(view.start_m / PERIOD_M) * PERIOD_M
    for lane in range(1, road.num_lanes):
        y = view.py(road.left_m + lane * road.lane_width_m)
        for x in np.arange(first, view.start_m + view.span_m, PERIOD_M):
            dash = (max(start, view.px(x)), y - 1, min(end, view.px(x + DASH_M)), y + 1)
            canvas.box(dash, colors.MARKING)
    for y_m in (road.left_m, road.right_m):
        y = view.py(y_m)
        canvas.box((start, y - 1, end, y + 1), colors.EDGE)
    for ramp in road.ramp_x_m:  # the edge of the road is broken where one may cross it
        merge = (max(left, view.px(ramp)), min(right, view.px(ramp + road.acceleration_lane_m)))
        y = view.py(road.right_m)
        canvas.box((merge[0], y - 1, merge[1], y + 1), colors.ASPHALT)
        for x in np.arange(ramp, ramp + road.acceleration_lane_m, 0.5 * PERIOD_M):
            canvas.box(
                (max(left, view.px(x)), y - 1, min(right, view.px(x + 0.5 * DASH_M)), y + 1),
                colors.EDGE,
            )


def _draw_ramp(canvas: Canvas, view: View, road: Roadway, ramp: float, *, marked: bool) -> None:
    """An acceleration lane, and the access road, which is drawn but not simulated."""
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
    """Metres along the road, under a view, and how much wider than long a metre is drawn."""
    left, _, right, bottom = view.box
    fits = [step for step in RULER_STEPS_M if step * view.along > 6.0 * font]
    step = fits[0] if fits else RULER_STEPS_M[-1]
    places = np.arange(np.ceil(view.start_m / step) * step, view.start_m + view.span_m + 1e-6, step)
    y = bottom + 0.9 * font
    for x in places:
        canvas.box(
            (view.px(x) - 0.5, bottom - 0.1 * font, view.px(x) + 0.5, bottom + 0.25 * font),
            colors.EDGE,
        )
    labels = [(view.px(x), f"{x:.0f} m") for x in places]
    canvas.labels(labels, y, font, colors.FAINT_INK, left + 0.5 * font, right - 0.5 * font)
