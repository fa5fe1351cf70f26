"""The player's page: what happens, colours, zoom, and what is seen at once, in headless Chromium."""

import re

import pytest

from medjax.render import colors
from medjax.render.player import player_page, show, write_player
from medjax.render.tracks import tracks_of
from medjax.world.state import IN_SERVICE
from tests.render.browser import opened, seconds, settle
from tests.render.made import blank, evaluated, put


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
    frames.ev_soc[:, 0], frames.ev_med[:, 0], frames.ev_panel[:, 0] = 0.5, 0, 0
    frames.ev_is_charging[12:, 0] = True
    path = tmp_path_factory.mktemp("made") / "made.html"
    write_player(path, [recording])
    return path


def test_what_happens_is_what_was_made(browser, made):
    """Times are those of the frames: charged from 12 on, standing for 5 s after 20 of them, told at 40."""
    with opened(browser, made) as page:
        texts = page.locator("#event-list li").all_inner_texts()
        assert texts == [
            "0:03 EV 1 is charged by MED 1",
            "0:08 gas 1 stands",
            "0:10 MED 1 told: 14 m/s in lane 1, takes EVs",
        ]
        page.locator("#event-list button").nth(1).click()
        settle(page)
        assert seconds(page) == 0.25 * (16 + 20 - 1)
        assert page.inner_text("#vehicle-panel h2") == "gas 1"
        assert page.input_value("#camera") == "selected"
        assert page.locator("#event-list li[aria-current]").inner_text() == texts[1]
        page.keyboard.press("n")
        settle(page)
        assert seconds(page) == 10.0
        page.keyboard.press("Shift+N")
        settle(page)
        assert seconds(page) == 8.75


def test_events_of_an_episode_are_all_there(browser, two, recording, other):
    """As many first charges as EVs that were ever charged, and one line for each dispatch and each that ran out."""
    charged = sum(
        recording.frames.ev_is_charging[track.first : track.last + 1, ev].any()
        for track in tracks_of(recording)
        if 0 <= (ev := track.slot - recording.config.ev_slots.start) < recording.config.num_evs
    )
    with opened(browser, two) as page:
        count = page.evaluate(
            "['sent', 'charge', 'out'].map((kind) => medjaxPlayer.events.events.filter((e) => e.kind === kind).length)"
        )
    both = (recording, other)
    sent = sum(int((each.decisions.sent > 0).sum()) for each in both)
    out = sum(int(each.decisions.tally.depleted.sum()) for each in both)
    assert count[:2] == [sent, charged]
    assert count[2] <= out  # one that ran out at the end still coasts
    assert charged > 0


def test_whose_event_it_is_can_be_heard(browser, two):
    """A colour says it to those who see it."""
    with opened(browser, two) as page:
        texts = page.locator("#event-list button").all_text_contents()
        whose = page.evaluate("medjaxPlayer.events.events.map(({ which }) => which)")
    assert [text.split(",")[0] for text in texts] == [("periodic", "none")[each] for each in whose]


def test_charts_and_playback_are_seen_together(browser, two):
    with opened(browser, two, width=1600, height=900) as page:
        bottoms = page.evaluate(
            "['#play', '#charts figure:last-child', '#event-list', '.view:last-child canvas']"
            ".map((name) => document.querySelector(name).getBoundingClientRect().bottom)"
        )
        assert max(bottoms) <= 900.0
        assert page.evaluate("document.querySelector('#event-list').clientHeight") >= 66


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (390, 844)])
def test_sizes(browser, two, width, height):
    with opened(browser, two, width=width, height=height) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        box = page.locator("#play").bounding_box()
        assert box["y"] + box["height"] <= height


def test_zoom_keeps_proportions_and_what_is_under_the_pointer(browser, made):
    with opened(browser, made) as page:
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


def test_colours_are_those_of_the_scale(browser, made):
    """At 30 m/s of 36 on the scale, standing, braking as hard as it goes, and stood for 8 s of 30."""

    def there(page):
        """The pixel in the middle of the gas vehicle."""
        return page.evaluate(
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

    with opened(browser, made) as page:
        page.evaluate(
            "medjaxPlayer.select(0, medjaxPlayer.episodes[0].tracks.find((t) => t.name === 'gas 1'))"
        )
        page.evaluate("medjaxPlayer.setCamera('selected')")
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
            wanted = colors.soc_color(round(100 * share) / 100)
            assert there(page) == pytest.approx(wanted, abs=1), name
        assert "stood for" in page.inner_text("#scale")


def test_a_click_on_the_ways_goes_there(browser, made):
    with opened(browser, made) as page:
        page.locator("#ways .plot").scroll_into_view_if_needed()
        box = page.locator("#ways .plot").bounding_box()
        plot = "medjaxPlayer.ways[0]"
        x, y = page.evaluate(f"[{plot}.toX(5), 5 + 0.25 * ({plot}.bottom - 8)]")
        page.mouse.click(box["x"] + x, box["y"] + y)
        settle(page)
        assert seconds(page) == pytest.approx(5.0, abs=0.1)
        assert page.evaluate("medjaxPlayer.camera.x") == pytest.approx(3000.0, abs=40.0)


def test_it_speaks_at_most_once_in_five_seconds(browser, made):
    """Nothing but the announcer is a live region, and it changes once in a second of play."""
    with opened(browser, made) as page:
        live = page.evaluate(
            "[...document.querySelectorAll('output, [aria-live], [role=status]')]"
            ".filter((e) => e.getAttribute('aria-live') !== 'off').map((e) => e.id)"
        )
        assert live == ["announcer"]
        page.evaluate(
            "window.said = 0; new MutationObserver(() => { window.said += 1; })"
            ".observe(document.querySelector('#announcer'), { childList: true })"
        )
        page.evaluate("medjaxPlayer.setSpeed(4); medjaxPlayer.play()")
        page.wait_for_timeout(1500)
        assert page.evaluate("window.said") == 1
        assert "MEDs sent" in page.inner_text("#announcer")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_road_and_vehicles_can_be_told_apart(browser, made, scheme):
    """WCAG 2.2, 1.4.11: 3:1 for what is needed to understand a picture."""
    with opened(browser, made) as page:
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

    def contrast(one, other):
        high, low = sorted((luminance(theme[one]), luminance(theme[other])), reverse=True)
        return (high + 0.05) / (low + 0.05)

    assert contrast("onMed", "med") >= 4.5
    for name in ("gas", "marking", "med", "edge"):
        assert contrast(name, "asphalt") >= 3.0, name
    assert contrast("out", "paper") >= 3.0
    assert contrast("ink", "paper") >= 7.0
    assert contrast("faint", "paper") >= 4.5


def test_means_of_many_episodes_stand_beside_this_one(browser, recording, other, tmp_path):
    path = tmp_path / "means.html"
    write_player(path, [recording, other], evaluation=evaluated(recording))
    with opened(browser, path) as page:
        rows = page.locator("#verdict tbody tr").all_inner_texts()
    assert len(rows) == 3
    cells = re.split(r"\s*\t\s*", rows[2].strip())
    assert cells == [
        "periodic, mean of 1000 episodes", "1.5", "1.5", "3.00", "568", "1.5", "7.2 [3.0, 11.5]",
    ]  # fmt: skip


def test_the_verdict_is_turned_on_a_phone(browser, recording, other, tmp_path):
    """Policies side by side, a number in a line, and no name is broken."""
    path = tmp_path / "means.html"
    write_player(path, [recording, other], evaluation=evaluated(recording))
    with opened(browser, path, width=390, height=844) as page:
        page.locator("#ending").click()
        assert page.locator("#verdict th[scope=row]").all_inner_texts()[0] == "ran out"
        assert page.locator("#verdict th[scope=col]").all_inner_texts()[0] == "periodic"
        heights = [row.bounding_box()["height"] for row in page.locator("#verdict tbody tr").all()]
        assert max(heights) < 45
        assert page.locator("#verdict").bounding_box()["width"] <= 366


def test_a_notebook_shows_the_page_in_a_frame(browser, recording, tmp_path):
    shown = show(recording, height=500)
    path = tmp_path / "notebook.html"
    path.write_text(f"<!DOCTYPE html><body>{shown._repr_html_()}</body>", encoding="utf-8")
    assert shown.page == player_page([recording])
    page = browser.new_page()
    page.goto(path.as_uri())
    frame = page.frames[1]
    frame.wait_for_selector("#verdict tbody tr")
    assert frame.evaluate("medjaxPlayer.episodes.length") == 1
    page.close()
