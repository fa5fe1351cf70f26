"""Draws vehicles, charging slots and links: as marks on the strip, as bodies in the camera's view."""

import numpy as np

from medjax.render import colors
from medjax.render.canvas import Canvas, text_width
from medjax.render.layout import Box, View
from medjax.render.legend import link, mark_free, mark_ran_out
from medjax.render.roadway import Roadway
from medjax.render.scene import Scene
from medjax.world.kinds import EVS, FUELLED, GAS, KINDS, MED, MEDS
from medjax.world.state import IN_SERVICE

# Least length of a mark in px, and its width as a share of a lane, by class of slots.
FAR_PX = {MEDS: (9.0, 1.0), EVS: (5.0, 0.8), FUELLED: (3.0, 0.6)}


def _soc(scene: Scene, slot: int) -> float:
    ev = slot - scene.num_meds
    return float(scene.ev_soc[ev]) if 0 <= ev < len(scene.ev_soc) else 0.0


def _back_to_front(scene: Scene) -> np.ndarray:
    """Occupied slots in drawing order; MEDs and EVs come last and so lie on top."""
    return np.nonzero(scene.active)[0][::-1]


def draw_far(canvas: Canvas, view: View, scene: Scene, road: Roadway, font: int) -> None:
    """Draws vehicles on the strip, larger than to scale."""
    lane = road.lane_width_m * view.per_m
    for slot in _back_to_front(scene):
        kind = int(scene.kind[slot])
        least, share = FAR_PX[KINDS[kind].slots]
        right = view.px(scene.x[slot])
        length = max(least, road.vehicle_length_m[kind] * view.along)
        y, half = view.py(scene.y[slot]), 0.5 * max(share * lane, 2.0)
        box = (max(right - length, view.box[0]), y - half, min(right, view.box[2]), y + half)
        canvas.box(box, colors.vehicle_color(kind, _soc(scene, slot)))
    for x in scene.ran_out_x:
        mark_ran_out(canvas, view.px(x), view.py(road.shoulder_m), min(0.35 * font, 0.6 * lane))


def _body(view: View, scene: Scene, road: Roadway, slot: int) -> Box:
    """Outline of a vehicle, px."""
    kind = int(scene.kind[slot])
    right, length = view.px(scene.x[slot]), road.vehicle_length_m[kind] * view.along
    y, half = view.py(scene.y[slot]), 0.5 * road.vehicle_width_m[kind] * view.per_m
    return right - length, y - half, right, y + half


def _middle(box: Box) -> tuple[float, float]:
    return 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])


def draw_close(canvas: Canvas, view: View, scene: Scene, road: Roadway, font: int) -> None:
    """Draws free slots, links, bodies with their charge, and marks of EVs that ran out."""
    left, _, right, _ = view.box
    bodies = {int(slot): _body(view, scene, road, slot) for slot in _back_to_front(scene)}
    _draw_slots(canvas, view, scene, road)
    booked = np.nonzero(scene.is_booked)[0]
    for ev in sorted(booked, key=lambda ev: scene.ev_is_charging[ev]):  # solid over dashed
        med = int(scene.ev_med[ev])
        if med in bodies:
            ends = _middle(bodies[med]), _middle(bodies[scene.num_meds + int(ev)])
            link(canvas, ends, font, charges=bool(scene.ev_is_charging[ev]))
    for slot, box in bodies.items():
        if box[2] > left and box[0] < right:
            tilt = np.tan(scene.heading[slot])
            slope = float(tilt * view.per_m / view.along), float(-tilt * view.along / view.per_m)
            _draw_body(canvas, box, slope, scene, slot, font)
    for x in scene.ran_out_x:
        if left <= view.px(x) <= right:
            place = view.px(x), view.py(road.shoulder_m)
            mark_ran_out(canvas, *place, min(0.45 * font, 0.4 * road.lane_width_m * view.per_m))


def _draw_slots(canvas: Canvas, view: View, scene: Scene, road: Roadway) -> None:
    """Draws the free slots on the road around MEDs in service."""
    booked = scene.is_booked
    taken = set(zip(scene.ev_med[booked], scene.ev_charging_slot[booked], strict=True))
    length, half = road.vehicle_length_m[GAS], 0.5 * road.vehicle_width_m[GAS] * view.per_m
    for med in np.nonzero((scene.med_status == IN_SERVICE) & scene.active[: scene.num_meds])[0]:
        for charging_slot, (ahead, aside) in enumerate(road.slots_m):
            x, y = scene.x[med] + ahead, scene.y[med] + aside
            if (med, charging_slot) in taken or not road.left_m < y < road.right_m:
                continue
            box = (view.px(x - length), view.py(y) - half, view.px(x), view.py(y) + half)
            if box[0] > view.box[0] and box[2] < view.box[2]:
                mark_free(canvas, box)


def _draw_body(
    canvas: Canvas, box: Box, slope: tuple[float, float], scene: Scene, slot: int, font: int
) -> None:
    """Draws a vehicle; EVs and MEDs that are long enough show their charge."""
    kind = int(scene.kind[slot])
    fill = colors.vehicle_color(kind, _soc(scene, slot))
    has_charge = KINDS[kind].slots != FUELLED
    canvas.body(box, slope, fill, colors.INK if has_charge else colors.EDGE)
    if not has_charge:
        return
    soc = float(scene.med_soc[slot]) if kind == MED else _soc(scene, slot)
    number = f"{100.0 * soc:.0f}"
    height = box[3] - box[1]
    width = box[2] - box[0] - 0.45 * height  # keeps the window free
    x, y = _middle(box)
    large, small = min(font, round(0.8 * height)), min(font, round(0.6 * height))
    full, percent = f"{scene.names[slot]}: {number} %", f"{number} %"
    choices = ((full, large), (full, small), (percent, large), (number, large), (number, small))
    for text, size in choices:
        if size >= 8 and text_width(text, size) + 0.35 * size <= width:
            canvas.text(x - 0.18 * height, y, text, size, colors.text_color(fill), "mm")
            return
