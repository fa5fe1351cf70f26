"""The player's page in headless Chromium: any width, two policies, any road, and how much it draws."""

import re

import numpy as np
import pytest

from medjax.render.player import player_page, show, write_player
from tests.render.browser import opened, seconds, settle
from tests.render.made import blank, evaluated

SIZES = [
    *[("two", width, 800) for width in (320, 400, 800, 1200, 1600)],
    *[("two", 1024, 768), ("two", 390, 844), ("one", 390, 900), ("one", 1600, 900)],
    *[("judged", 320, 800), ("judged", 390, 844), ("judged", 800, 800), ("judged", 1024, 768)],
    *[("judged", 1200, 800), ("judged", 1600, 900)],
]


@pytest.fixture(scope="module")
def judged(recording, other, tmp_path_factory):
    """The page of two recordings with means of many episodes."""
    path = tmp_path_factory.mktemp("judged") / "judged.html"
    write_player(path, [recording, other], evaluation=evaluated(recording))
    return path


@pytest.mark.parametrize(("path", "width", "height"), SIZES)
def test_everything_fits_any_width(browser, path, width, height, request):
    """Nothing is cut off, terms are printed rather than in a tooltip, and the play button stays in sight."""
    with opened(browser, request.getfixturevalue(path), width=width, height=height) as page:
        check_controls(page, width, height)
        page.evaluate("document.querySelector('#outcome').open = true")
        text = page.inner_text("#terms")
        assert "cost, EUR: time lost" in text
        assert "return: the reward" in text
        assert "mobile energy disseminators" in page.inner_text("#lead")
        assert page.locator("#story [title]").count() == 0
        page.keyboard.press("e")
        settle(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        outside = page.evaluate(
            "[...document.querySelectorAll('main *')].filter((e) => e.getClientRects().length && !e.closest('.unseen')"
            "&& (e.getBoundingClientRect().right > innerWidth + 1 || e.getBoundingClientRect().left < -1))"
            ".map((e) => e.outerHTML.slice(0, 80))"
        )
        assert outside == []
        check_controls(page, width, height)


def check_controls(page, width, height):
    """They stay in sight, are low on small screens, and cover no road that fits on the screen."""
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    play = page.locator("#play").bounding_box()
    assert play["y"] + play["height"] <= height
    if (width, height) in ((1024, 768), (390, 844)):
        assert page.locator("#controls").bounding_box()["height"] <= 90
        page.locator(".view canvas").last.evaluate(
            "(road) => road.scrollIntoView({ block: 'end' })"
        )
        controls = page.locator("#controls").bounding_box()
        for road in page.locator(".view canvas").all():
            box = road.bounding_box()
            assert box["y"] >= controls["y"] + controls["height"]
            assert box["y"] + box["height"] <= height + 1
        page.evaluate("scrollTo(0, 0)")


def test_a_small_screen_shows_two_roads_and_play_at_once(browser, two):
    with opened(browser, two, width=1024, height=768) as page:
        bottoms = page.evaluate(
            "['#play', '.view:last-child canvas']"
            ".map((name) => document.querySelector(name).getBoundingClientRect().bottom)"
        )
    assert max(bottoms) <= 768.0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_crosses_have_no_line_s_colour(browser, two, scheme):
    """Neither a policy's nor that of charging or booking: a channel differs by a fifth of its range or more."""
    page = browser.new_page(color_scheme=scheme)
    page.goto(two.as_uri())
    colours = page.evaluate(
        """() => {
          const style = getComputedStyle(document.documentElement);
          const part = (hex, at) => parseInt(hex.slice(at, at + 2), 16);
          const rgb = (name) => [1, 3, 5].map((at) => part(style.getPropertyValue(name).trim(), at));
          return ["--out", "--first", "--second", "--med", "--ink"].map(rgb);
        }"""
    )
    cross, *lines = np.array(colours) / 255
    assert (np.abs(lines - cross).max(axis=1) > 0.2).all()
    page.close()


def test_a_wide_page_shows_charts_events_and_playback_together(pages, two):
    """The panel of no vehicle is a low hint, and the policies stand side by side."""
    page = pages(two)
    bottoms = page.evaluate(
        "['#play', '#charts figure:last-child', '#event-list', '.view:last-child canvas']"
        ".map((name) => document.querySelector(name).getBoundingClientRect().bottom)"
    )
    assert max(bottoms) <= 900.0
    assert page.evaluate("document.querySelector('#event-list').clientHeight") >= 66
    assert page.locator("#vehicle-panel").bounding_box()["height"] < 100
    tops = [box.bounding_box()["y"] for box in page.locator("#dispatch-panel > div").all()]
    assert tops[0] == tops[1]


@pytest.mark.parametrize("width", [390, 1600])
def test_every_ev_in_the_picture_has_its_charge(browser, still, tmp_path, width):
    write_player(tmp_path / "still.html", [still])
    with opened(browser, tmp_path / "still.html", width=width) as page:
        page.evaluate("medjaxPlayer.setCamera('free', 975)")
        settle(page)
        texts = page.evaluate(
            """() => {
              const { road } = medjaxPlayer.views[0];
              const { context, camera } = road;
              const said = [];
              const own = context.fillText;
              context.fillText = function (text, x, y) {
                if (y > camera.top + 5 && y < camera.bottom) said.push(text);
                return own.call(this, text, x, y);
              };
              road.draw(0, null);
              return said;
            }"""
        )
    charges = sorted(text.split(": ")[-1] for text in texts if "%" in text)
    assert charges == ["25 %", "50 %", "75 %"]


def test_two_policies_share_one_clock(pages, two):
    page = pages(two)
    assert page.locator(".view canvas").count() == 2
    assert page.locator(".view-line .name").all_inner_texts() == ["periodic", "none"]
    page.evaluate("medjaxPlayer.seek(60)")
    settle(page)
    assert page.evaluate("medjaxPlayer.episodes.map((e) => e.frame)") == [240, 240]
    lines = page.locator(".view-line").all_inner_texts()
    assert "MEDs sent 2, fleet 3" in lines[0]
    assert "MEDs sent 0, fleet 3" in lines[1]
    titles = page.locator("#dispatch-panel h2").all_inner_texts()
    assert titles == ["Dispatch: periodic", "Dispatch: none"]


def test_a_full_highway_takes_a_few_strokes_a_vehicle(browser, full, tmp_path):
    """Counts calls of the canvas rather than time; vehicles out of sight take none."""
    write_player(tmp_path / "full.html", [full])
    with opened(browser, tmp_path / "full.html") as page:
        near, far = page.evaluate(
            """() => {
              let calls = 0;
              const canvas = CanvasRenderingContext2D.prototype;
              for (const name of ["fill", "stroke", "fillRect", "strokeRect", "fillText", "measureText"]) {
                const own = canvas[name];
                canvas[name] = function (...given) { calls += 1; return own.apply(this, given); };
              }
              return [2, -2].map((zoom) => {
                medjaxPlayer.zoom = zoom;
                calls = 0;
                medjaxPlayer._show(100);
                return calls;
              });
            }"""
        )
        there = page.evaluate(
            "medjaxPlayer.episodes[0].present.filter((track) => track >= 0).length"
        )
    assert there > 150
    assert far < 12 * there
    assert near < far - there


@pytest.mark.parametrize("road", [{"num_ramps": 0, "num_gas": 0}, {"num_lanes": 1, "num_ramps": 1}])
def test_any_empty_road(browser, tmp_path, road):
    write_player(tmp_path / "blank.html", [blank(9, **road)])
    with opened(browser, tmp_path / "blank.html") as page:
        for key in ("m", "e", "d", "f", "a", "End"):
            page.keyboard.press(key)
        settle(page)
        assert seconds(page) == 2.0
        assert "MEDs sent 0" in page.inner_text(".view-line")


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_a_full_highway_plays_at_50_frames_a_second(browser, full, tmp_path, count):
    write_player(tmp_path / "full.html", [full] * count)
    with opened(browser, tmp_path / "full.html") as page:
        page.keyboard.press("m")
        rate = page.evaluate(
            """() => new Promise((done) => {
              medjaxPlayer.play();
              let [frames, start] = [0, null];
              const count = (now) => {
                start ??= now;
                if (now - start > 3000) return done((1000 * frames) / (now - start));
                frames += 1;
                requestAnimationFrame(count);
              };
              requestAnimationFrame(count);
            })"""
        )
    assert rate >= 50.0


def test_the_page_opens_before_the_first_charge_with_story_and_verdict(browser, two, recording):
    charging = np.asarray(recording.frames.ev_is_charging).any(axis=1)
    first = np.flatnonzero(charging)[0] * recording.config.tick_s
    ran_out = int(np.sum(recording.decisions.stats.depleted))
    with opened(browser, two) as page:
        assert "fewer crosses is better" in page.inner_text("#lead")
        assert 0.0 <= first - seconds(page) <= 5.0
        assert not page.evaluate("medjaxPlayer.clock.playing")
        words = page.locator("#policies dd").all_inner_texts()
        assert words[0].startswith("Spreads the fleet evenly")
        assert words[1].startswith("Never sends")
        rows = page.locator("#verdict tbody tr")
        assert rows.count() == 2
        assert rows.nth(0).locator("td").first.inner_text().split()[0] == str(ran_out)
        sent = rows.nth(0).locator("td").nth(4).inner_text()
        assert int(sent) == int((recording.decisions.sent > 0).sum())


def test_means_of_many_episodes_stand_beside_this_one(browser, judged):
    with opened(browser, judged) as page:
        rows = page.locator("#verdict tbody tr").all_inner_texts()
    assert len(rows) == 3
    assert re.split(r"\s*\t\s*", rows[2].strip()) == [
        "periodic, mean of 1000 episodes", "1.5", "1.5", "3.00", "568", "1.5", "7.2 [3.0, 11.5]",
    ]  # fmt: skip


def test_the_verdict_is_turned_on_a_phone(browser, judged):
    """Policies side by side, a number in a line, and no name is broken."""
    with opened(browser, judged, width=390, height=844) as page:
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
