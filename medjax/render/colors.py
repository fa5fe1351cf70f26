"""Colours of the pictures and the player. Shape and pattern differ as well, so any colour vision suffices.

State of charge runs from dark blue (empty) over magenta to yellow (full), like matplotlib's plasma. Its lightness
rises in even steps, and it avoids the green of MEDs and the grey of gas vehicles.
"""

from medjax.world.kinds import EVS, KINDS, MED

Color = tuple[int, int, int]

PAPER: Color = (255, 255, 255)
INK: Color = (31, 35, 40)
FAINT_INK: Color = (96, 103, 112)
GRASS: Color = (243, 245, 242)
ASPHALT: Color = (224, 227, 231)
MARKING: Color = (122, 128, 137)
EDGE: Color = (120, 127, 136)

MED_COLOR: Color = (21, 135, 57)  # white text on it has a contrast of 4.6:1
GAS_COLOR: Color = (112, 119, 128)
RAN_OUT: Color = (140, 0, 25)  # no line of the player has it
ACCENT: Color = (0, 114, 178)  # the camera's stretch, and what is selected

SOC_SCALE: tuple[Color, ...] = (
    (13, 8, 135),
    (76, 2, 161),
    (126, 3, 168),
    (169, 35, 149),
    (204, 71, 120),
    (229, 107, 93),
    (248, 149, 64),
    (253, 197, 39),
    (240, 249, 33),
)
"""Colours at equal steps of the state of charge from 0 to 1, interpolated linearly."""


def soc_color(soc: float) -> Color:
    """Colour of a state of charge, which is clipped to [0, 1]."""
    position = min(max(soc, 0.0), 1.0) * (len(SOC_SCALE) - 1)
    index = min(int(position), len(SOC_SCALE) - 2)
    share = position - index
    low, high = SOC_SCALE[index], SOC_SCALE[index + 1]
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(low, high, strict=True))
    return red, green, blue


def vehicle_color(kind: int, soc: float) -> Color:
    """Fill of a vehicle; `soc` matters for EVs only."""
    if KINDS[kind].slots == EVS:
        return soc_color(soc)
    return MED_COLOR if kind == MED else GAS_COLOR


def text_color(background: Color) -> Color:
    """Black or white, whichever reads better on `background`; the contrast is at least 4.5:1 on `SOC_SCALE`."""
    red, green, blue = background
    return (0, 0, 0) if 0.299 * red + 0.587 * green + 0.114 * blue > 112 else PAPER


def css(color: Color) -> str:
    """The colour as `#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*color)
