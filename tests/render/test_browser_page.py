"""The player's page in headless Chromium: any width, two policies, any road, and how fast it is drawn."""

import pytest

from medjax.render.player import write_player
from tests.render.browser import opened, seconds, settle
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


def test_two_full_highways_are_drawn_in_less_than_a_50th_of_a_second(browser, full, tmp_path):
    write_player(tmp_path / "full.html", [full, full])
    with opened(browser, tmp_path / "full.html") as page:
        page.keyboard.press("m")
        milliseconds = page.evaluate(
            """() => {
              const start = performance.now();
              for (let i = 0; i < 200; i += 1) medjaxPlayer._show(100 + 0.016 * i);
              return (performance.now() - start) / 200;
            }"""
        )
    assert milliseconds < 20.0


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
