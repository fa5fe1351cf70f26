"""The player as a reader has it: headless Chromium, keys and clicks."""

import re

import numpy as np
import pytest

from medjax.render.scene import Timeline
from medjax.render.tracks import tracks_of
from tests.render.browser import facts, opened, seconds, settle, until


def an_ev_that_charges(recording):
    """(time in s, slot, EV) of a charging one."""
    frame, ev = np.argwhere(recording.frames.ev_is_charging)[40]
    return recording.time_s[frame], recording.config.ev_slots.start + ev, ev


def test_unpacks_the_recording(browser, one, recording):
    with opened(browser, one) as page:
        steps = page.evaluate(
            "['x', 'y', 'evSoc', 'probability'].map((name) => "
            "{ const t = medjaxPlayer.episodes[0].tables[name]; return Array.from(t.steps, (s) => s * t.step); })"
        )
    frames = recording.frames
    width = float(recording.params.road.lane_width_m)
    lateral = frames.lane * width + frames.lateral_offset
    there = frames.active.T.ravel()
    for found, true in zip(steps[:2], (frames.x, lateral), strict=True):
        np.testing.assert_allclose(np.array(found)[there], true.T.ravel()[there], atol=0.00501)
    np.testing.assert_allclose(steps[2], frames.ev_soc.T.ravel(), atol=0.51e-4)
    np.testing.assert_allclose(steps[3], recording.decisions.probabilities.T.ravel(), atol=0.51e-4)


def test_plays_at_true_speed_and_pauses(browser, one):
    """From picture to picture as much of the episode as time has passed between them, however many there are."""
    with opened(browser, one) as page:
        page.evaluate(
            """() => {
              const { clock } = medjaxPlayer;
              const tick = clock.onTick;
              window.seen = [];
              // The browser's own time of the picture, not the one that the player keeps.
              clock.onTick = (seconds) => {
                tick(seconds);
                if (clock.playing) seen.push([document.timeline.currentTime / 1000, seconds]);
              };
            }"""
        )
        for speed in (1.0, 4.0):
            page.select_option("#speed", f"{speed:g}")
            page.evaluate("seen.length = 0")
            page.click("#play")
            until(page, "seen.length > 60")
            page.click("#play")
            times, played = np.diff(page.evaluate("seen"), axis=0).T
            assert (times > 0.0).all()
            # A picture that comes half a second late is taken for one of a page in the background.
            np.testing.assert_allclose(played, speed * np.minimum(times, 0.5), atol=1e-6)
        now = seconds(page)
        page.wait_for_timeout(200)
        assert seconds(page) == now
        assert page.inner_text("#play") == "Play"


def test_stops_at_the_end_and_starts_again(browser, one):
    with opened(browser, one) as page:
        page.evaluate("medjaxPlayer.seek(89.9); medjaxPlayer.play()")
        until(page, "!medjaxPlayer.clock.playing")
        assert seconds(page) == 90.0
        page.click("#play")
        assert seconds(page) < 45.0


def test_scrubs(browser, one, recording):
    with opened(browser, one) as page:
        box = page.locator("#scrub").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        settle(page)
        assert seconds(page) == pytest.approx(45.0, abs=0.5)
        shown = page.inner_text("#time")
        assert re.fullmatch(r"0:4[45]\.\d\d / 1:30", shown)
        evs = recording.frames.active[Timeline(recording).frame_at(seconds(page)), 3:15].sum()
        assert f"EVs {evs} " in page.inner_text(".view-line")


def test_a_click_selects_and_the_numbers_are_the_recordings(browser, one, recording):
    time, slot, ev = an_ev_that_charges(recording)
    frame, frames = round(time / 0.25), recording.frames
    with opened(browser, one) as page:
        page.evaluate(
            f"medjaxPlayer.setCamera('free', {frames.x[frame, slot]}); medjaxPlayer.seek({time})"
        )
        settle(page)
        x, y = frames.x[frame, slot] - 2.5, 4.0 * frames.lane[frame, slot]
        y += frames.lateral_offset[frame, slot]
        place = page.evaluate(
            f"(({{camera}}) => [camera.px({x}), camera.py({y})])(medjaxPlayer.views[0].road)"
        )
        box = page.locator(".view canvas").bounding_box()
        page.mouse.click(box["x"] + place[0], box["y"] + place[1])
        settle(page)
        track = next(
            t for t in tracks_of(recording) if t.slot == slot and t.first <= frame <= t.last
        )
        assert page.inner_text("#vehicle-panel h2") == track.name
        found = facts(page)
        assert found["position"] == f"{frames.x[frame, slot]:.1f} m"
        assert found["speed"] == f"{frames.speed[frame, slot]:.2f} m/s"
        assert found["charge"].startswith(f"{100 * frames.ev_soc[frame, ev]:.2f} %")
        assert found["booked"].endswith("charging")
        assert "begins to charge" in page.inner_text("#vehicle-panel .events")
        page.keyboard.press("Escape")
        assert page.inner_text("#vehicle-panel h2") == "No vehicle selected"


def test_follows_a_vehicle_from_the_list(browser, one, recording):
    track = next(t for t in tracks_of(recording) if t.kind == "EV" and t.first > 20)
    index = tracks_of(recording).index(track)
    with opened(browser, one) as page:
        page.evaluate("medjaxPlayer.seek(0)")
        page.select_option("#vehicle", f"0:{index}")
        settle(page)
        assert seconds(page) == pytest.approx(track.first * 0.25)
        page.evaluate(f"medjaxPlayer.seek({0.25 * (track.first + 60)})")
        settle(page)
        center = page.evaluate("medjaxPlayer.views[0].road.center")
        assert center == pytest.approx(recording.frames.x[track.first + 60, track.slot], abs=0.1)


def test_dispatch_shows_the_decision_and_its_probabilities(browser, one, recording):
    decisions = recording.decisions
    first = int(np.nonzero(decisions.sent)[0][1])
    ramp = int(decisions.sent[first])
    with opened(browser, one) as page:
        page.evaluate(f"medjaxPlayer.seek({first - 0.5})")
        page.keyboard.press("d")
        settle(page)
        assert seconds(page) == first
        assert f"a MED from ramp {ramp}" in page.inner_text("#dispatch-panel p")
        rows = page.locator("#dispatch-panel tr").all_inner_texts()
        assert [float(row.split()[-1]) for row in rows] == decisions.probabilities[first].tolist()
        reward = page.locator("#dispatch-panel p").nth(1).inner_text()
        assert f"Reward {decisions.reward[first]:.3f}" in reward


def test_a_dispatch_is_shown_at_its_ramp(browser, two, recording):
    """By its key and by its mark, each under the pointer."""
    second = int(np.flatnonzero(recording.decisions.sent)[1])
    ramp_m = float(recording.params.road.ramp_x_m[recording.decisions.sent[second] - 1])
    with opened(browser, two) as page:
        for act in (
            lambda: page.keyboard.press("d"),
            lambda: page.locator("#marks i").nth(1).click(),
        ):
            page.evaluate("medjaxPlayer.setCamera('free', 3000); medjaxPlayer.seek(1)")
            settle(page)
            act()
            settle(page)
            assert seconds(page) == second
            assert page.evaluate("medjaxPlayer.camera") == {"mode": "free", "x": ramp_m}


KEYS = [
    ("ArrowRight", 11.0), ("ArrowLeft", 9.0), ("Shift+ArrowRight", 20.0), ("Shift+ArrowLeft", 0.0),
    (".", 10.25), (",", 9.75), ("Home", 0.0), ("End", 90.0),
]  # fmt: skip


def test_every_key_does_what_the_help_says(browser, one):
    with opened(browser, one) as page:
        for key, at in KEYS:
            page.evaluate("medjaxPlayer.seek(10)")
            page.keyboard.press(key)
            assert seconds(page) == pytest.approx(at), key
        page.evaluate("medjaxPlayer.seek(40)")
        settle(page)
        page.keyboard.press("m")
        assert page.inner_text("#vehicle-panel h2").startswith("MED")
        page.keyboard.press("e")
        first = page.inner_text("#vehicle-panel h2")
        page.keyboard.press("e")
        assert page.inner_text("#vehicle-panel h2") != first
        page.keyboard.press("Shift+E")
        assert page.inner_text("#vehicle-panel h2") == first
        page.keyboard.press("g")
        assert page.inner_text("#vehicle-panel h2").startswith("gas")
        assert page.input_value("#camera") == "selected"
        page.keyboard.press("a")
        assert page.input_value("#camera") == "auto"
        page.keyboard.press("f")
        assert page.input_value("#camera") == "selected"
        page.keyboard.press("+")
        assert page.evaluate("medjaxPlayer.zoom") == 0.25
        page.keyboard.press("]")
        assert page.input_value("#camera") == "free"
        page.keyboard.press("ArrowUp")
        assert page.input_value("#speed") == "2"
        page.keyboard.press("Space")
        assert page.evaluate("medjaxPlayer.clock.playing")
        page.keyboard.press("Space")
        assert not page.evaluate("medjaxPlayer.clock.playing")
        page.keyboard.press("?")
        assert page.locator("#help").is_visible()
        page.keyboard.press("Escape")
        assert not page.locator("#help").is_visible()


def test_tab_reaches_every_control_and_shows_where_it_is(browser, one):
    with opened(browser, one) as page:
        reached = set()
        for _ in range(14):
            page.keyboard.press("Tab")
            name, outline = page.evaluate(
                "[document.activeElement.id, getComputedStyle(document.activeElement).outlineWidth]"
            )
            reached.add(name)
            assert outline == "3px"
        controls = "help-button scrub play back forward speed camera zoom vehicle"
        assert set(controls.split()) <= reached
