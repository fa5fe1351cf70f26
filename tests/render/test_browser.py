"""The player in headless Chromium: what keys and clicks do."""

import re

import numpy as np
import pytest

from medjax.render.scene import Timeline
from medjax.render.tracks import tracks_of
from tests.render.browser import facts, seconds, settle, until


def test_unpacks_the_recording(pages, one, recording):
    steps = pages(one).evaluate(
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


def test_plays_at_true_speed_pauses_and_ends(pages, one):
    """The clock advances by the time between pictures, however many there are."""
    page = pages(one)
    page.evaluate(
        """() => {
          const { clock } = medjaxPlayer;
          const tick = clock.onTick;
          window.seen = [];
          // The browser's own time of the picture, not the player's.
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
        # The player takes a gap of more than half a second for a page in the background.
        np.testing.assert_allclose(played, speed * np.minimum(times, 0.5), atol=1e-6)
    now = seconds(page)
    page.wait_for_timeout(200)
    assert seconds(page) == now
    assert page.inner_text("#play") == "Play"
    page.evaluate("medjaxPlayer.seek(89.9); medjaxPlayer.play()")
    until(page, "!medjaxPlayer.clock.playing")
    assert seconds(page) == 90.0
    page.click("#play")
    assert seconds(page) < 45.0


def test_scrubs(pages, one, recording):
    page = pages(one)
    box = page.locator("#scrub").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    settle(page)
    assert seconds(page) == pytest.approx(45.0, abs=0.5)
    assert re.fullmatch(r"0:4[45]\.\d\d / 1:30", page.inner_text("#time"))
    evs = recording.frames.active[Timeline(recording).frame_at(seconds(page)), 3:15].sum()
    assert f"EVs {evs} " in page.inner_text(".view-line")


def test_a_click_selects_a_vehicle_and_shows_its_numbers(pages, one, recording):
    frame, ev = np.argwhere(recording.frames.ev_is_charging)[40]
    slot, frames = recording.config.ev_slots.start + ev, recording.frames
    page = pages(one)
    page.evaluate(
        f"medjaxPlayer.setCamera('free', {frames.x[frame, slot]}); "
        f"medjaxPlayer.seek({recording.time_s[frame]})"
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
    track = next(t for t in tracks_of(recording) if t.slot == slot and t.first <= frame <= t.last)
    assert page.inner_text("#vehicle-panel h2") == track.name
    found = facts(page)
    assert found["position"] == f"{frames.x[frame, slot]:.1f} m"
    assert found["speed"] == f"{frames.speed[frame, slot]:.2f} m/s"
    assert found["charge"].startswith(f"{100 * frames.ev_soc[frame, ev]:.2f} %")
    assert found["booked"].endswith("charging")
    assert "begins to charge" in page.inner_text("#vehicle-panel .events")
    page.keyboard.press("Escape")
    assert page.inner_text("#vehicle-panel h2") == "No vehicle selected"


def test_follows_a_vehicle_from_the_list(pages, one, recording):
    tracks, page = tracks_of(recording), pages(one)
    track = next(t for t in tracks if t.kind == "EV" and t.first > 20)
    page.select_option("#vehicle", f"0:{tracks.index(track)}")
    settle(page)
    assert seconds(page) == pytest.approx(track.first * 0.25)
    page.evaluate(f"medjaxPlayer.seek({0.25 * (track.first + 60)})")
    settle(page)
    center = page.evaluate("medjaxPlayer.views[0].road.center")
    assert center == pytest.approx(recording.frames.x[track.first + 60, track.slot], abs=0.1)


def test_a_dispatch_is_shown_with_its_decision(pages, one, recording):
    decisions, page = recording.decisions, pages(one)
    second = int(np.flatnonzero(decisions.sent)[1])
    page.evaluate(f"medjaxPlayer.seek({second - 0.5})")
    page.keyboard.press("d")
    settle(page)
    assert seconds(page) == second
    assert f"a MED from ramp {decisions.sent[second]}" in page.inner_text("#dispatch-panel p")
    rows = page.locator("#dispatch-panel tr").all_inner_texts()
    assert [float(row.split()[-1]) for row in rows] == decisions.probabilities[second].tolist()
    reward = page.locator("#dispatch-panel p").nth(1).inner_text()
    assert f"Reward {decisions.reward[second]:.3f}" in reward


def test_a_dispatch_is_shown_at_its_ramp(pages, two, recording):
    """By its key and by its mark; of two policies each shows its own decision."""
    decisions, page = recording.decisions, pages(two)
    second = int(np.flatnonzero(decisions.sent)[1])
    ramp = int(decisions.sent[second])
    ramp_m = float(recording.params.road.ramp_x_m[ramp - 1])
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
    panel = page.locator("#dispatch-panel > div").first
    assert f"a MED from ramp {ramp}" in panel.locator("p").first.inner_text()
    rows = panel.locator("tr").all_inner_texts()
    assert [float(row.split()[-1]) for row in rows] == decisions.probabilities[second].tolist()


KEYS = [
    ("ArrowRight", 11.0), ("ArrowLeft", 9.0), ("Shift+ArrowRight", 20.0), ("Shift+ArrowLeft", 0.0),
    (".", 10.25), (",", 9.75), ("Home", 0.0), ("End", 90.0),
]  # fmt: skip


def test_every_key_does_what_the_help_says(pages, one):
    page = pages(one)

    def selected_after(key):
        page.keyboard.press(key)
        return page.inner_text("#vehicle-panel h2")

    def value_after(key, control):
        page.keyboard.press(key)
        return page.input_value(control)

    for key, at in KEYS:
        page.evaluate("medjaxPlayer.seek(10)")
        page.keyboard.press(key)
        assert seconds(page) == pytest.approx(at), key
    page.evaluate("medjaxPlayer.seek(40)")
    settle(page)
    assert selected_after("m").startswith("MED")
    first = selected_after("e")
    assert selected_after("e") != first
    assert selected_after("Shift+E") == first
    assert selected_after("g").startswith("gas")
    assert page.input_value("#camera") == "selected"
    assert value_after("a", "#camera") == "auto"
    assert value_after("f", "#camera") == "selected"
    page.keyboard.press("+")
    assert page.evaluate("medjaxPlayer.zoom") == 0.25
    assert value_after("]", "#camera") == "free"
    assert value_after("ArrowUp", "#speed") == "2"
    for playing in (True, False):
        page.keyboard.press("Space")
        assert page.evaluate("medjaxPlayer.clock.playing") == playing
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("Escape")
    assert not page.locator("#help").is_visible()


def test_tab_reaches_every_control_and_outlines_it(pages, one):
    page = pages(one)
    page.evaluate("document.activeElement.blur()")
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


def test_the_address_holds_time_and_followed_vehicle(pages, one):
    """`#t=..&follow=..` is read, and written once the clock has stood still for a moment."""
    page = pages(one)
    page.evaluate("location.hash = '#t=12.5&follow=med1'")
    until(page, "medjaxPlayer.clock.seconds === 12.5")
    assert page.evaluate("medjaxPlayer.selected.track.name") == "MED 1"
    assert page.evaluate("medjaxPlayer.camera.mode") == "selected"
    page.evaluate("medjaxPlayer.seek(40.25)")
    until(page, "location.hash === '#t=40.25&follow=MED1'")
    page.locator("#marks i").nth(1).click(force=True)
    settle(page)
    assert seconds(page) == page.evaluate("medjaxPlayer.dispatch[0].sent[1].seconds")
