"""What a pointer is told, what is drawn of intents, and what is said of orders, in headless Chromium."""

import pytest

from medjax.render.player import write_player
from medjax.world.state import IN_SERVICE, LEAVING
from tests.render.browser import opened, settle
from tests.render.made import blank, put

EXITS = {"exit_x_m": [1800.0]}


@pytest.fixture(scope="module")
def page_of_things(tmp_path_factory):
    """A MED at 1000 m in lane 3 charges EV 1 at its left; EV 2 makes for its rear slot; EV 3 ran out at 940 m.

    The MED is told to refuse EVs from the start, and makes for the only exit at 6 s, where it is gone at 9 s; on its
    way it is told to go to the second depot.
    """
    recording = blank(1 + 4 * 10, **EXITS, num_depots=2)
    config, frames = recording.config, recording.frames
    fleet, ev = recording.params.fleet, config.ev_slots.start
    put(recording, 0, 1000.0, 2, frames=slice(0, 24))
    put(recording, 0, 1790.0, 3, frames=slice(24, 36))
    frames.med_status[:24, 0], frames.med_status[24:, 0] = IN_SERVICE, LEAVING
    frames.med_depot[30:, 0] = 1
    frames.med_service_speed[:, 0] = fleet.service_speed
    frames.med_service_lane[:, 0] = fleet.service_lane
    put(recording, ev, 996.5, 1)
    put(recording, ev + 1, 950.0, 1)
    put(recording, ev + 2, 940.0, 3, frames=slice(0, 4))
    frames.ev_soc[:, :2] = 0.5
    frames.ev_soc[:2, 2] = 0.01
    for number, panel in ((0, 0), (1, 2)):
        frames.ev_med[:24, number], frames.ev_panel[:24, number] = 0, panel
    frames.ev_is_charging[:24, 0] = True
    path = tmp_path_factory.mktemp("things") / "things.html"
    write_player(path, [recording], start_s=2.0)
    return path


def test_anything_tells_what_it_is(browser, page_of_things):
    """At the camera's scale, by the pointer's own way: its title."""
    with opened(browser, page_of_things) as page:
        page.evaluate("medjaxPlayer.setCamera('free', 980)")
        settle(page)
        box = page.locator(".view canvas").bounding_box()

        def told(x, y, part="camera"):
            place = page.evaluate(
                f"(({{ {part}: view }}) => [view.px({x}), view.py({y})])(medjaxPlayer.views[0].road)"
            )
            page.mouse.move(box["x"] + place[0], box["y"] + place[1])
            return page.evaluate("document.querySelector('.view canvas').title")

        slots = page.evaluate("medjaxPlayer.episodes[0].slots()")
        right, rear = (next(s for s in slots if s["panel"] == panel) for panel in (1, 2))
        shoulder = page.evaluate("medjaxPlayer.episodes[0].meta.road.shoulder")
        assert told(940.0, shoulder).startswith("EV 3 ran out, at 0:01")
        assert told(right["x"] - 2.0, right["y"]).startswith("right slot of MED 1, free")
        assert told(rear["x"] - 2.0, rear["y"]).startswith("rear slot of MED 1, booked by EV 2")
        assert told(994.0, 6.0).startswith("MED 1 charges EV 1, left slot")
        assert told(925.0, 0.0).startswith("lane 1 of 4; 925 m")
        assert told(100.0, 16.0, "strip").startswith("ramp 1")
        assert told(1750.0, 16.0, "strip").startswith("exit 1")
        page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 2)
        title = page.evaluate("document.querySelector('.view canvas').title")
        assert "traffic here" in title
        for name in ("#charts .plot", "#ways .plot", "#dispatch-panel .plot"):
            page.locator(name).first.hover()
            title = page.evaluate("(name) => document.querySelector(name).title", name)
            assert "at 0:0" in title, name


def test_a_booking_ends_at_its_slot_which_is_outlined(browser, page_of_things):
    """With nobody selected: where lines and rectangles go is asked of the canvas."""
    with opened(browser, page_of_things) as page:
        page.evaluate("medjaxPlayer.setCamera('free', 980)")
        settle(page)
        ends, outlines, slot = page.evaluate(
            """() => {
              const { road } = medjaxPlayer.views[0];
              const { context, camera, episode } = road;
              const [ends, outlines] = [[], []];
              const { lineTo, strokeRect } = CanvasRenderingContext2D.prototype;
              context.lineTo = function (x, y) { ends.push([x, y]); return lineTo.call(this, x, y); };
              context.strokeRect = function (...box) { outlines.push(box); return strokeRect.apply(this, box); };
              road.draw(2, null);
              const { length, width } = episode.meta.slotBody;
              const { x, y } = episode.slots().find(({ panel }) => panel === 2);
              const box = [camera.px(x - length), camera.py(y - width / 2), length * camera.perX, width * camera.perY];
              return [ends, outlines, box];
            }"""
        )
    middle = [slot[0] + slot[2] / 2, slot[1] + slot[3] / 2]
    assert any(end == pytest.approx(middle) for end in ends)
    assert any(box == pytest.approx(slot) for box in outlines)


def test_the_first_order_and_the_way_home_are_told(browser, page_of_things):
    """Its first order is not the fleet's own: it is to refuse EVs."""
    with opened(browser, page_of_things) as page:
        texts = page.locator("#event-list li").all_inner_texts()
    told = [text for text in texts if "MED 1 told" in text]
    assert len(told) == 1
    assert told[0].startswith("0:00")
    assert told[0].endswith("refuses EVs")
    assert "0:06 MED 1 makes for exit 1 and depot 2" in texts


@pytest.mark.parametrize("width", [390, 1600])
def test_what_terms_mean_is_printed(browser, page_of_things, width):
    """No word of it is to be had by a mouse alone."""
    with opened(browser, page_of_things, width=width) as page:
        page.evaluate("document.querySelector('#outcome').open = true")
        text = page.inner_text("#terms")
        assert "cost, EUR: time lost" in text
        assert "return: the reward" in text
        assert "mobile energy disseminators" in page.inner_text("#story")
        assert page.locator("#story [title]").count() == 0
        assert page.evaluate("document.documentElement.scrollWidth") <= width
