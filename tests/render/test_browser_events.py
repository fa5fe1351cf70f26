"""The player in headless Chromium: events, colours, zoom and tooltips."""

import pytest

from medjax.render import colors
from medjax.render.player import write_player
from medjax.render.tracks import tracks_of
from medjax.world.state import IN_SERVICE, LEAVING
from tests.render.browser import opened, seconds, settle
from tests.render.made import blank, put


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A gas vehicle that drives, stands for 8 s and goes on; a MED that is told another speed; an EV beside it."""
    recording = blank(1 + 4 * 20)
    config, frames = recording.config, recording.frames
    gas = config.gas_slots.start
    put(recording, gas, 100.0, 1, speed=30.0)
    frames.speed[16:48, gas] = 0.0
    put(recording, 0, 1000.0, 2, speed=22.0)
    frames.med_status[:, 0], frames.med_soc[:, 0] = IN_SERVICE, 0.9
    fleet = recording.params.fleet
    frames.med_service_speed[:, 0], frames.med_accepts[:, 0] = fleet.service_speed, True
    frames.med_service_lane[:, 0] = fleet.service_lane
    frames.med_service_speed[40:, 0] = 14.0
    frames.med_service_lane[40:, 0] = 0
    ev = config.ev_slots.start
    put(recording, ev, 996.5, 1, speed=22.0)
    frames.ev_soc[:, 0], frames.ev_med[:, 0], frames.ev_charging_slot[:, 0] = 0.5, 0, 0
    frames.ev_is_charging[12:, 0] = True
    path = tmp_path_factory.mktemp("made") / "made.html"
    write_player(path, [recording])
    return path


@pytest.fixture(scope="module")
def parting(tmp_path_factory):
    """A MED at 1000 m in lane 3 charges EV 1 at its left; EV 2 drives to its rear slot; EV 3 ran out at 940 m.

    The MED refuses EVs from the start. It leaves for the only exit at 6 s and is gone at 9 s; on the way it is told to
    go to the second depot.
    """
    recording = blank(1 + 4 * 10, exit_x_m=[1800.0], num_depots=2)
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
    for number, slot in ((0, 0), (1, 2)):
        frames.ev_med[:24, number], frames.ev_charging_slot[:24, number] = 0, slot
    frames.ev_is_charging[:24, 0] = True
    path = tmp_path_factory.mktemp("parting") / "parting.html"
    write_player(path, [recording], start_s=2.0)
    return path


def test_events_happen_at_their_frames(pages, made):
    """Charging starts at frame 12, the gas vehicle has stood for 5 s 20 frames after 16, the order comes at 40."""
    page = pages(made)
    texts = page.locator("#event-list li").all_inner_texts()
    assert texts == [
        "0:03 EV 1 is charged by MED 1",
        "0:08 gas 1 stands still",
        "0:10 MED 1 ordered: 14 m/s in lane 1, accepts EVs",
    ]
    page.locator("#event-list button").nth(1).click()
    settle(page)
    assert seconds(page) == 0.25 * (16 + 20 - 1)
    assert page.inner_text("#vehicle-panel h2") == "gas 1"
    assert page.input_value("#camera") == "selected"
    assert page.locator("#event-list li[aria-current]").inner_text() == texts[1]
    for key, time in (("n", 10.0), ("Shift+N", 8.75)):
        page.keyboard.press(key)
        settle(page)
        assert seconds(page) == time


def test_the_page_opens_at_the_given_time(browser, parting):
    with opened(browser, parting) as page:
        assert seconds(page) == 2.0


def test_the_first_order_and_the_exit_are_events(pages, parting):
    """The first order differs from the fleet's: refuse EVs."""
    texts = pages(parting).locator("#event-list li").all_inner_texts()
    (told,) = [text for text in texts if "MED 1 ordered" in text]
    assert told.startswith("0:00")
    assert told.endswith("refuses EVs")
    assert "0:06 MED 1 heads for exit 1 and depot 2" in texts


def test_events_of_two_episodes_are_complete_and_name_their_policy(pages, two, recording, other):
    """As many first charges as EVs that were ever charged, and a line for each dispatch and each EV that ran out."""
    page = pages(two)
    charged = sum(
        recording.frames.ev_is_charging[track.first : track.last + 1, ev].any()
        for track in tracks_of(recording)
        if 0 <= (ev := track.slot - recording.config.ev_slots.start) < recording.config.num_evs
    )
    kinds, whose = page.evaluate(
        "['kind', 'which'].map((name) => medjaxPlayer.events.events.map((event) => event[name]))"
    )
    both = (recording, other)
    assert kinds.count("sent") == sum(int((each.decisions.sent > 0).sum()) for each in both)
    assert kinds.count("charge") == charged > 0
    # One that ran out at the end still coasts.
    assert kinds.count("out") <= sum(int(each.decisions.stats.depleted.sum()) for each in both)
    texts = page.locator("#event-list button").all_text_contents()
    assert [text.split(",")[0] for text in texts] == [("periodic", "none")[each] for each in whose]


def test_zoom_keeps_proportions_and_the_place_under_the_pointer(pages, made):
    page = pages(made)
    page.evaluate("medjaxPlayer.setCamera('free', 2000)")
    settle(page)
    box = page.locator(".view canvas").bounding_box()
    camera = "medjaxPlayer.views[0].road.camera"
    middle = page.evaluate(f"{camera}.top + {camera}.height / 2")
    x = 0.25 * box["width"]
    shape = f"[{camera}.perX / {camera}.perY, {camera}.metres({x}), {camera}.perX]"
    ratio, place, scale = page.evaluate(shape)
    page.mouse.move(box["x"] + x, box["y"] + middle)
    for delta, larger in ((-300, True), (900, False)):
        page.mouse.wheel(0, delta)
        settle(page)
        after = page.evaluate(shape)
        assert after[0] == pytest.approx(ratio, rel=1e-6)
        assert after[1] == pytest.approx(place, abs=0.5)
        assert (after[2] > scale) == larger
    assert page.evaluate("window.scrollY") == 0


def test_colours_are_those_of_the_scale(pages, made):
    """At 30 m/s of 36 on the scale, standing, braking hardest, and after standing for 8 s of 30."""
    page = pages(made)
    page.evaluate(
        "medjaxPlayer.select(0, medjaxPlayer.episodes[0].tracks.find((t) => t.name === 'gas 1'));"
        "medjaxPlayer.setCamera('selected')"
    )
    for name, time, share in (
        ("speed", 2.0, 30 / 36),
        ("speed", 6.0, 0.0),
        ("acceleration", 4.0, 0.0),
        ("acceleration", 2.0, 0.5),
        ("waiting", 11.75, 8 / 30),
    ):
        page.select_option("#colour", name)
        page.evaluate(f"medjaxPlayer.seek({time})")
        settle(page)
        # The pixel in the middle of the gas vehicle.
        found = page.evaluate(
            """() => {
              const { road } = medjaxPlayer.views[0];
              const { slot, body } = medjaxPlayer.selected.track;
              const { episode, camera, canvas } = road;
              const [x, y] = [camera.px(episode.x[slot] - body.length / 2), camera.py(episode.y[slot])];
              const pixel = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
              pixel.drawImage(canvas, x, y, 1, 1, 0, 0, 1, 1);
              return [...pixel.getImageData(0, 0, 1, 1).data.slice(0, 3)];
            }"""
        )
        assert found == pytest.approx(colors.soc_color(round(100 * share) / 100), abs=1), name
    assert "standing for" in page.inner_text("#scale")


def test_a_click_on_the_time_space_diagram_goes_there(pages, made):
    page = pages(made)
    page.locator("#ways .plot").scroll_into_view_if_needed()
    box = page.locator("#ways .plot").bounding_box()
    plot = "medjaxPlayer.ways[0]"
    x, y = page.evaluate(f"[{plot}.toX(5), 5 + 0.25 * ({plot}.bottom - 8)]")
    page.mouse.click(box["x"] + x, box["y"] + y)
    settle(page)
    assert seconds(page) == pytest.approx(5.0, abs=0.1)
    assert page.evaluate("medjaxPlayer.camera.x") == pytest.approx(3000.0, abs=40.0)


def test_only_the_announcer_speaks_and_at_most_once_in_five_seconds(pages, made):
    page = pages(made)
    live = page.evaluate(
        "[...document.querySelectorAll('output, [aria-live], [role=status]')]"
        ".filter((e) => e.getAttribute('aria-live') !== 'off').map((e) => e.id)"
    )
    assert live == ["announcer"]
    page.evaluate(
        "window.said = 0; new MutationObserver(() => { window.said += 1; })"
        ".observe(document.querySelector('#announcer'), { childList: true })"
    )
    page.evaluate("medjaxPlayer._said = -Infinity; medjaxPlayer.setSpeed(4); medjaxPlayer.play()")
    page.wait_for_timeout(1500)
    assert page.evaluate("window.said") == 1
    assert "MEDs sent" in page.inner_text("#announcer")


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_road_and_vehicles_have_contrast(pages, made, scheme):
    """WCAG 2.2, 1.4.11: 3:1 for what is needed to understand a picture."""
    page = pages(made)
    page.emulate_media(color_scheme=scheme)
    settle(page)
    theme = page.evaluate(
        "Object.fromEntries(['asphalt', 'gas', 'marking', 'med', 'onMed', 'edge', 'out', 'paper', 'ink', 'faint']"
        ".map((name) => [name, medjaxPlayer.theme[name]]))"
    )

    def luminance(text):
        parts = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    for name, ground, least in (
        ("onMed", "med", 4.5),
        *((name, "asphalt", 3.0) for name in ("gas", "marking", "med", "edge")),
        ("out", "paper", 3.0),
        ("ink", "paper", 7.0),
        ("faint", "paper", 4.5),
    ):
        low, high = sorted((luminance(theme[name]), luminance(theme[ground])))
        assert (high + 0.05) / (low + 0.05) >= least, name


def test_tooltips_name_everything(pages, parting):
    """By the title of the canvas under the pointer."""
    page = pages(parting)
    page.evaluate("medjaxPlayer.setCamera('free', 980); medjaxPlayer.seek(2)")
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
    assert told(940.0, shoulder).startswith("EV 3 ran out, at 0:00")
    page.evaluate("medjaxPlayer.seek(0.5)")  # it stands on the road, without energy
    settle(page)
    assert told(940.0, shoulder).startswith("EV 3 ran out, at 0:00")
    page.evaluate("medjaxPlayer.seek(0.25)")
    settle(page)
    assert "ran out" not in told(940.0, shoulder)
    page.evaluate("medjaxPlayer.seek(2)")
    settle(page)
    assert told(right["x"] - 2.0, right["y"]).startswith("right slot of MED 1, free")
    assert told(rear["x"] - 2.0, rear["y"]).startswith("rear slot of MED 1, booked by EV 2")
    assert told(994.0, 6.0).startswith("MED 1 charges EV 1, left slot")
    assert told(925.0, 0.0).startswith("lane 1 of 4; 925 m")
    assert told(100.0, 16.0, "strip").startswith("ramp 1")
    assert told(1750.0, 16.0, "strip").startswith("exit 1")
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 2)
    assert "mean speed here" in page.evaluate("document.querySelector('.view canvas').title")
    for name in ("#charts .plot", "#ways .plot", "#dispatch-panel .plot"):
        page.locator(name).first.hover()
        title = page.evaluate("(name) => document.querySelector(name).title", name)
        assert "at 0:0" in title, name


def test_a_booking_ends_at_its_slot_which_is_outlined(pages, parting):
    """With nobody selected; a spy on the canvas records lines and rectangles."""
    page = pages(parting)
    page.evaluate("medjaxPlayer.setCamera('free', 980); medjaxPlayer.seek(2)")
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
          delete context.lineTo;
          delete context.strokeRect;
          const { length, width } = episode.meta.slotBody;
          const { x, y } = episode.slots().find(({ panel }) => panel === 2);
          const box = [camera.px(x - length), camera.py(y - width / 2), length * camera.perX, width * camera.perY];
          return [ends, outlines, box];
        }"""
    )
    middle = [slot[0] + slot[2] / 2, slot[1] + slot[3] / 2]
    assert any(end == pytest.approx(middle) for end in ends)
    assert any(box == pytest.approx(slot) for box in outlines)
