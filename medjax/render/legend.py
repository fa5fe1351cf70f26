"""The legend, and the header with its clock and counters."""

from itertools import pairwise

from medjax.render import colors
from medjax.render.canvas import Canvas, Points, text_width
from medjax.render.layout import Box, Layout
from medjax.render.scene import Scene

# Label of each symbol, and its width in font sizes.
ENTRIES = {
    "med": ("MED", 2.4),
    "gas": ("gas vehicle", 1.8),
    "soc": ("EV, charge 0 to 100 %", 5.0),
    "link": ("charging", 1.8),
    "booked": ("booked", 1.8),
    "slot": ("free slot", 1.6),
    "ran out": ("EV ran out", 1.0),
}


def legend_rows(width: float, font: int) -> list[list[str]]:
    """Arranges the entries in rows that fit the width."""
    rows: list[list[str]] = [[]]
    used = 0.0
    for name, (label, symbol) in ENTRIES.items():
        entry = font * symbol + 2.0 * font + text_width(label, font)
        if rows[-1] and used + entry - font > width:
            rows.append([])
            used = 0.0
        rows[-1].append(name)
        used += entry
    return rows


def draw_legend(canvas: Canvas, layout: Layout) -> None:
    """Draws all entries, in rows."""
    left, top, right, bottom = layout.legend
    if bottom <= top:
        return
    font = layout.font
    rows = legend_rows(right - left, font)
    height = (bottom - top) / len(rows)
    for number, row in enumerate(rows):
        x, y = left, top + (number + 0.5) * height
        for name in row:
            label, symbol = ENTRIES[name]
            _symbol(canvas, name, x, y, font * symbol, font)
            x += font * symbol + 0.5 * font
            canvas.text(x, y, label, font, colors.INK)
            x += text_width(label, font) + 1.5 * font


def _symbol(canvas: Canvas, name: str, x: float, y: float, width: float, font: int) -> None:
    half = 0.36 * font
    box = (x, y - half, x + width, y + half)
    plain = {"med": (colors.MED_COLOR, colors.INK), "gas": (colors.GAS_COLOR, colors.EDGE)}
    if name in plain:
        canvas.box(box, *plain[name])
    elif name == "soc":
        for pixel in range(round(width)):
            shade = colors.soc_color(pixel / width)
            canvas.box((x + pixel, y - half, x + pixel + 1.0, y + half), shade)
        canvas.box(box, None, colors.INK)
    elif name in ("link", "booked"):
        link(canvas, [(x, y), (x + width, y)], font, charges=name == "link")
    elif name == "slot":
        mark_free(canvas, box)
    else:
        mark_ran_out(canvas, x + 0.5 * width, y, 0.36 * font)


def link(canvas: Canvas, ends: Points, font: int, *, charges: bool) -> None:
    """Draws the line from a MED to an EV, dashed unless it charges."""
    if charges:
        canvas.line(ends, colors.PAPER, 0.5 * font)
        canvas.line(ends, colors.MED_COLOR, 0.28 * font)
    else:
        canvas.dashes(ends, colors.INK, 0.11 * font, 0.4 * font, 0.3 * font)


def mark_free(canvas: Canvas, box: Box) -> None:
    """Draws the dashed outline of a free slot."""
    left, top, right, bottom = box
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
    for side in pairwise(corners):
        canvas.dashes(side, colors.EDGE, 1.0, 3.0, 2.5)


def mark_ran_out(canvas: Canvas, x: float, y: float, radius: float) -> None:
    """Marks an EV without energy."""
    canvas.cross(x, y, radius, colors.PAPER, 0.9 * radius)
    canvas.cross(x, y, radius, colors.RAN_OUT, 0.5 * radius)


def draw_header(canvas: Canvas, layout: Layout, scene: Scene) -> None:
    """Draws the clock, the counters and the title, as many from the left as fit."""
    left, top, right, bottom = layout.header
    font, middle, large = layout.font, 0.5 * (top + bottom), round(1.25 * layout.font)
    on_road = scene.evs_on_road
    charging = int((scene.ev_is_charging & on_road).sum())
    counters = [
        f"MEDs sent {scene.sent}, fleet {scene.fleet}",
        f"EVs {int(on_road.sum())}",
        f"charging {charging}",
        f"on the way to a slot {int(scene.is_booked.sum()) - charging}",
        f"ran out {scene.ran_out}",
    ]
    if on_road.any():
        counters.insert(2, f"mean charge {100.0 * scene.ev_soc[on_road].mean():.0f} %")
    tenths = int(scene.time_s * 10.0 + 1e-6)
    clock = f"{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"
    canvas.text(left, middle, clock, large, colors.INK)
    x = left + text_width("00:00.0", large) + font
    for text in counters:
        if x + text_width(text, font) > right:
            return
        canvas.text(x, middle, text, font, colors.INK)
        x += text_width(text, font) + 1.2 * font
    if x + text_width(scene.title, font) <= right:
        canvas.text(right, middle, scene.title, font, colors.FAINT_INK, "rm")
