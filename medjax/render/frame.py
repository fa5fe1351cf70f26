"""One instant as an RGB array: the whole road as a strip, and a camera's view of a stretch of it."""

import functools

import numpy as np

from medjax.errors import InputError
from medjax.render import colors
from medjax.render.asphalt import draw_asphalt, draw_ruler
from medjax.render.camera import busiest_place
from medjax.render.canvas import Canvas
from medjax.render.layout import SIZE, Layout, View, check_size, font_size
from medjax.render.legend import draw_header, draw_legend, legend_rows
from medjax.render.roadway import Roadway
from medjax.render.scene import Scene, scene_of_state
from medjax.render.traffic import draw_close, draw_far
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.presets import SCENARIOS
from medjax.world.state import EnvState


def draw(
    scene: Scene,
    road: Roadway,
    center_m: float,
    *,
    width: int = SIZE[0],
    height: int = SIZE[1],
    span_m: float | None = None,
) -> np.ndarray:
    """Draws a scene.

    Args:
      scene: what is on the road.
      road: the road.
      center_m: middle of the camera's stretch, which is shifted to stay on the road.
      width: px.
      height: px.
      span_m: length of that stretch; None chooses 120 to 400 m by the height of the lanes.

    Returns:
      `(height, width, 3)` uint8.

    Raises:
      InputError: the size is out of range, or span_m is not positive.
    """
    check_size(width, height)
    if span_m is not None and not span_m > 0.0:
        raise InputError(f"span_m = {span_m}: allowed (0, inf)")
    font = font_size(width, height)
    layout = Layout.of(width, height, len(legend_rows(width - font, font)), font)
    camera = layout.camera_view(road, center_m, span_m)
    canvas = Canvas(width, height, colors.PAPER)
    draw_header(canvas, layout, scene)
    _draw_strip(canvas, layout.strip_view(road), scene, road, camera, font)
    draw_asphalt(canvas, camera, road, marked=True)
    draw_close(canvas, camera, scene, road, font)
    draw_ruler(canvas, camera, road, font)
    draw_legend(canvas, layout)
    return canvas.finish()


def render_state(
    state: EnvState,
    config: EnvConfig,
    params: EnvParams | None = None,
    *,
    name: str = "paper",
    width: int = SIZE[0],
    height: int = SIZE[1],
) -> np.ndarray:
    """Draws a state of one environment, with the camera where most EVs charge.

    Args:
      state: the state.
      config: of its environment.
      params: of its environment; None uses the preset `name`, which is right if `medjax.make` overrode nothing.
      name: of the environment, shown as the title.
      width: px.
      height: px.

    Returns:
      `(height, width, 3)` uint8.

    Raises:
      InputError: one line; the size is out of range, no preset has that name, or its batteries do not fit the state.
    """
    if params is None:
        params = _preset(name, config)
        batteries = (state.evs, params.ev_capacity_j), (state.meds, params.med_capacity_j)
        if any(np.max(each.energy_j) > 1.001 * float(capacity_j) for each, capacity_j in batteries):
            raise InputError(f"the state is of other batteries than preset {name!r}: give params")
    scene, road = scene_of_state(state, config, params, name), Roadway.of(config, params)
    return draw(scene, road, busiest_place(scene, road), width=width, height=height)


@functools.cache
def _preset(name: str, config: EnvConfig) -> EnvParams:
    if name not in SCENARIOS:
        raise InputError(f"no preset {name!r}: give params")
    return SCENARIOS[name].params(config)


def _draw_strip(
    canvas: Canvas, strip: View, scene: Scene, road: Roadway, camera: View, font: int
) -> None:
    """Draws the whole road, and a frame around the camera's stretch."""
    draw_asphalt(canvas, strip, road, marked=False)
    draw_far(canvas, strip, scene, road, font)
    left, right = strip.px(camera.start_m), strip.px(camera.start_m + camera.span_m)
    top, bottom = strip.box[1], strip.box[3]
    canvas.box((left - 1, top, right + 1, bottom), None, colors.ACCENT, 1.5)
    labels = [(strip.px(x), f"ramp {number}") for number, x in enumerate(road.ramp_x_m, 1)]
    canvas.labels(labels, bottom + 0.65 * font, font, strip.box[0], strip.box[2])
