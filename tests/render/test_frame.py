"""Pictures: colours are where the state says, at any size, of any road."""

import matplotlib as mpl
import numpy as np
import pytest

from medjax.render import colors
from medjax.render.scene import Timeline
from medjax.world.state import MERGING
from tests.render.made import TICKS, blank, put

pytest.importorskip("PIL", reason="pictures need Pillow")
from medjax.render.frame import draw, render_state

WIDTH, SPAN = 1000, 200.0  # 5 px a metre
CENTER = 980.0
NEAR = slice(180, 350)  # rows of the camera's lanes in a picture of 480


def picture(recording, time=0.0, **options):
    timeline = Timeline(recording)
    options = {"width": WIDTH, "height": 480, "span_m": SPAN} | options
    return draw(timeline.at(time), timeline.roadway, CENTER, **options)


def columns_of(image, color, rows=NEAR):
    """Columns with at least three pixels of exactly a colour."""
    return np.nonzero((image[rows] == color).all(axis=-1).sum(axis=0) >= 3)[0]


def px(x):
    """Column of a place."""
    return (x - (CENTER - SPAN / 2)) * WIDTH / SPAN


def test_a_med_is_green_from_its_rear_to_its_front_bumper(still):
    columns = columns_of(picture(still), colors.MED_COLOR)
    beside_links = columns[columns > px(985.0)]
    assert abs(beside_links.min() - px(988.0)) <= 3
    assert abs(beside_links.max() - px(1000.0)) <= 3


@pytest.mark.parametrize(("soc", "x"), [(0.5, 996.5), (0.25, 940.0)])
def test_an_ev_has_the_colour_of_its_charge(still, soc, x):
    columns = columns_of(picture(still), colors.soc_color(soc))
    assert px(x - 5.0) - 2 <= columns.min() < columns.max() <= px(x) + 2


def test_gas_is_gray_and_moves_with_time():
    recording = blank(1 + TICKS)
    put(recording, recording.config.gas_slots.start, 950.0, 1, speed=20.0)
    for time in (0.0, 0.3, 0.75):
        columns = columns_of(picture(recording, time), colors.GAS_COLOR)
        assert abs(columns.max() - px(950.0 + 20.0 * time)) <= 4


def test_a_charging_link_is_solid_and_a_booking_dashed(still):
    image = picture(still)
    between = slice(int(px(942.0)), int(px(986.0)))
    # the far EV is in the MED's lane: its dashes lie on one row
    rows = (image[NEAR, between] == colors.INK).all(axis=-1)
    dashes = rows[rows.sum(axis=1).argmax()]
    assert 0.2 < dashes.mean() < 0.8
    assert np.abs(np.diff(dashes.astype(int))).sum() > 8
    # the near one is beside it: green between their bodies
    link = (image[NEAR, int(px(994.0))] == colors.MED_COLOR).all(axis=-1)
    assert link.sum() > 20


def test_an_ev_that_ran_out_is_marked_and_counted():
    recording = blank(1 + TICKS)
    ev = recording.config.ev_slots.start
    put(recording, ev, 1010.0, 0, frames=slice(0, 3))
    recording.frames.x[3:, ev] = 1010.0
    recording.frames.ev_soc[:2, 0] = 0.1
    rows = slice(350, 430)
    assert not len(columns_of(picture(recording, 0.25), colors.RAN_OUT, rows))
    columns = columns_of(picture(recording, 0.75), colors.RAN_OUT, rows)
    assert abs(columns.mean() - px(1010.0)) < 3
    assert Timeline(recording).at(0.75).ran_out == 1


@pytest.mark.parametrize("sideways", [-3.0, 0.0, 2.0])
def test_a_body_heads_where_it_drives(sideways):
    """The slope of its side, in metres, is its lateral speed over its speed."""
    recording = blank(1 + TICKS)
    put(recording, 0, 1000.0, 2, speed=15.0)
    recording.frames.lateral_speed[:, 0] = sideways
    recording.frames.med_status[:, 0] = MERGING  # no slots around it
    green = (picture(recording)[NEAR] == colors.MED_COLOR).all(axis=-1)
    columns = np.arange(int(px(990.0)), int(px(996.0)))
    top, bottom = green.argmax(axis=0)[columns], green[::-1].argmax(axis=0)[columns]
    per_m = (len(green) - bottom - top).mean() / 2.5  # across
    slope = np.polyfit(columns, top, 1)[0] * (WIDTH / SPAN) / per_m
    assert slope == pytest.approx(sideways / 15.0, abs=0.04)


def test_evs_that_run_out_are_counted_and_marked_at_once_beside_them_then_where_they_leave():
    recording = blank(1 + 2 * TICKS)
    ev = recording.config.ev_slots.start
    put(recording, ev, 1000.0, 0, speed=10.0, frames=slice(0, 6))
    recording.frames.ev_soc[:2, 0] = 0.1
    timeline = Timeline(recording)
    assert [timeline.at(frame * 0.25).ran_out for frame in range(8)] == [0, 0, 1, 1, 1, 1, 1, 1]
    where = [timeline.at(frame * 0.25).ran_out_x for frame in range(8)]
    assert [len(xs) for xs in where] == [0, 0, 1, 1, 1, 1, 1, 1]
    # 10 m/s until it leaves: its last tick on the road is the sixth
    np.testing.assert_allclose(np.ravel(where[2:]), [1005.0, 1007.5, 1010.0, *3 * [1012.5]])
    rows = slice(350, 430)
    assert not len(columns_of(picture(recording, 0.25), colors.RAN_OUT, rows))
    for time_s, x_m in ((0.5, 1005.0), (0.625, 1006.25), (1.25, 1012.5), (1.5, 1012.5)):
        columns = columns_of(picture(recording, time_s), colors.RAN_OUT, rows)
        assert abs(columns.mean() - px(x_m)) < 3


def test_the_scale_of_charge_is_even_and_readable():
    plasma = mpl.colormaps["plasma"]
    shares = np.linspace(0.0, 1.0, 101)
    scale = np.array([colors.soc_color(share) for share in shares])
    assert np.abs(scale - 255 * plasma(shares)[:, :3]).max() < 12
    light = scale @ [0.299, 0.587, 0.114]
    text = np.array([colors.text_color(tuple(color)) for color in scale])
    assert np.all(np.diff(light) > 0)
    assert np.all(np.abs(light - text @ [0.299, 0.587, 0.114]) > 75)
    assert colors.soc_color(-1.0) == colors.soc_color(0.0)
    # Text on it has the contrast of WCAG 2.2, 1.4.3.
    for color in (*map(tuple, scale), colors.MED_COLOR):
        low, high = sorted((luminance(color), luminance(colors.text_color(color))))
        assert (high + 0.05) / (low + 0.05) >= 4.5


def luminance(color):
    parts = np.array(color) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize("size", [(160, 120), (200, 600), (401, 301), (1600, 200), (1920, 1080)])
def test_any_size(still, size):
    image = picture(still, width=size[0], height=size[1], span_m=None)
    assert image.shape == (size[1], size[0], 3)
    assert image.dtype == np.uint8


@pytest.mark.parametrize("size", [(159, 480), (1000, 119), (9000, 480)])
def test_bad_sizes_are_refused_in_one_line(still, size):
    with pytest.raises(ValueError, match=r"^(width|height) = \d+: allowed 1\d0 to 8192 px$"):
        picture(still, width=size[0], height=size[1])


@pytest.mark.parametrize(
    "road",
    [
        {},
        {"num_ramps": 0},
        {"num_lanes": 1},
        {"num_lanes": 6, "num_ramps": 1},
        {"length_m": 900.0, "num_ramps": 0},
    ],
)
def test_any_empty_road(road):
    assert picture(blank(1 + TICKS, **road)).std() > 0


def test_the_environment_draws_its_states(paper, started):
    """Without params only where the preset's fit."""
    (env, params), (_, state) = paper, started
    image = env.render(state, params, width=640, height=240)
    assert image.shape == (240, 640, 3)
    np.testing.assert_array_equal(image, env.render(state, width=640, height=240))
    full = state.replace(evs=state.evs.replace(energy_j=state.evs.energy_j * 1e3))
    with pytest.raises(ValueError, match="give params"):
        env.render(full)
    with pytest.raises(ValueError, match="no preset 'mine'"):
        render_state(state, env.config, name="mine")
