"""The player's page in headless Chromium: any width, two policies, any road, and how fast it is drawn."""

import numpy as np
import pytest

from medjax.render.player import write_player
from tests.render.browser import opened, seconds, settle, until
from tests.render.made import blank


@pytest.mark.parametrize("width", [320, 400, 800, 1200, 1600])
def test_nothing_is_cut_off_at_any_width(browser, two, width):
    with opened(browser, two, width=width, height=800) as page:
        page.keyboard.press("e")
        settle(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        outside = page.evaluate(
            "[...document.querySelectorAll('main *')].filter((e) => e.getClientRects().length && !e.closest('.unseen')"
            "&& (e.getBoundingClientRect().right > innerWidth + 1 || e.getBoundingClientRect().left < -1))"
            ".map((e) => e.outerHTML.slice(0, 80))"
        )
        assert outside == []


def test_no_panel_stands_empty(browser, two):
    """With nobody selected there is a hint, as high as its words, and the policies stand side by side."""
    with opened(browser, two, width=1600, height=900) as page:
        hint = page.locator("#vehicle-panel").bounding_box()
        assert hint["height"] < 100
        tops = [box.bounding_box()["y"] for box in page.locator("#dispatch-panel > div").all()]
        assert tops[0] == tops[1]


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (390, 844)])
def test_what_stays_in_sight_is_low(browser, two, width, height):
    """Scrubber and one row of buttons; the rest of the controls scrolls away with the page."""
    with opened(browser, two, width=width, height=height) as page:
        assert page.locator("#controls").bounding_box()["height"] <= 90


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


def test_two_policies_share_one_clock(browser, two):
    with opened(browser, two) as page:
        assert page.locator(".view canvas").count() == 2
        assert page.locator(".view-line .name").all_inner_texts() == ["periodic", "none"]
        page.evaluate("medjaxPlayer.seek(60)")
        settle(page)
        assert page.evaluate("medjaxPlayer.episodes.map((e) => e.frame)") == [240, 240]
        lines = page.locator(".view-line").all_inner_texts()
        assert "MEDs sent 2 of 3" in lines[0]
        assert "MEDs sent 0 of 3" in lines[1]
        titles = page.locator("#dispatch-panel h2").all_inner_texts()
        assert titles == ["Dispatch: periodic", "Dispatch: none"]


def test_a_full_highway_takes_a_few_strokes_a_vehicle(browser, full, tmp_path):
    """Work, not time, which is the machine's: calls of the canvas, fewer where less of the road is seen."""
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
    assert near < far - there  # who is out of sight takes none


@pytest.mark.parametrize("road", [{"num_ramps": 0, "num_gas": 0}, {"num_lanes": 1, "num_ramps": 1}])
def test_any_road_and_nobody_on_it(browser, tmp_path, road):
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


def test_words_say_what_is_seen_and_who_acts(browser, two, recording):
    """It opens before the first charge; policies are explained; the verdict is the episode's."""
    charging = np.asarray(recording.frames.ev_is_charging).any(axis=1)
    first = np.flatnonzero(charging)[0] * recording.config.tick_s
    ran_out = int(np.sum(recording.decisions.tally.depleted))
    with opened(browser, two) as page:
        assert "fewer crosses is better" in page.inner_text("#story")
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


def test_the_address_says_where_one_is(browser, one):
    """`#t=..&follow=..` is read, and written once the clock has stood still for a moment."""
    with opened(browser, one) as page:
        page.evaluate("location.hash = '#t=12.5&follow=med1'")
        until(page, "medjaxPlayer.clock.seconds === 12.5")
        assert page.evaluate("medjaxPlayer.selected.track.name") == "MED 1"
        assert page.evaluate("medjaxPlayer.camera.mode") == "selected"
        page.evaluate("medjaxPlayer.seek(40.25)")
        until(page, "location.hash === '#t=40.25&follow=MED1'")
        page.locator("#marks i").nth(1).click(force=True)
        settle(page)
        assert seconds(page) == page.evaluate("medjaxPlayer.dispatch[0].sent[1].seconds")
