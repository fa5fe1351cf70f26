"""The camera in headless Chromium: one for both roads, it stays on a vehicle and glides to the next one."""

import dataclasses

import numpy as np
import pytest

from medjax.render.player import write_player
from medjax.world.state import IN_SERVICE
from tests.render.browser import settle
from tests.render.made import blank, put

NAMED = "(name) => medjaxPlayer.episodes[0].tracks.find((track) => track.name === name)"


@pytest.fixture(scope="module")
def driving(tmp_path_factory):
    """A MED at 22 m/s from 1000 m, and a gas vehicle at 30 m/s from 2500 m, for 20 s."""
    recording = blank(1 + 4 * 20)
    put(recording, 0, 1000.0, 2, speed=22.0)
    recording.frames.med_status[:, 0] = IN_SERVICE
    put(recording, recording.config.gas_slots.start, 2500.0, 1, speed=30.0)
    path = tmp_path_factory.mktemp("driving") / "driving.html"
    write_player(path, [recording])
    return path


def follow(page, name):
    page.evaluate(
        f"medjaxPlayer.select(0, ({NAMED})('{name}')); medjaxPlayer.setCamera('selected')"
    )


@pytest.mark.parametrize("step", [0.02, 1.0])
def test_a_followed_vehicle_stands_still_in_every_picture(pages, driving, step):
    """While the clock plays: within a tick, and at 16 times the speed with few pictures a second."""
    page = pages(driving, glides=True)
    follow(page, "gas 1")
    page.evaluate("medjaxPlayer.seek(2)")
    settle(page)
    away = page.evaluate(
        """(step) => {
          const player = medjaxPlayer;
          const { road } = player.views[0];
          player.clock.playing = true; // only this draws: nothing wakes the clock
          const away = Array.from({ length: 12 }, (_, i) => {
            player._show(2 + i * step);
            return road.episode.x[player.selected.track.slot] - road.center;
          });
          player.clock.playing = false;
          return away;
        }""",
        step,
    )
    np.testing.assert_allclose(away, 0.0, atol=1e-9)


@pytest.mark.parametrize("playing", [True, False])
def test_the_camera_glides_to_another_vehicle(pages, driving, playing):
    """It starts near the vehicle that it leaves and ends at the other."""
    page = pages(driving, glides=True)
    follow(page, "MED 1")
    page.evaluate("medjaxPlayer.seek(1)")
    settle(page)
    page.evaluate(f"if ({str(playing).lower()}) medjaxPlayer.play()")
    page.evaluate(
        """() => {
          const { road } = medjaxPlayer.views[0];
          window.seen = [];
          road.aim = (x, ...rest) => { Object.getPrototypeOf(road).aim.call(road, x, ...rest); window.seen.push(x); };
        }"""
    )
    follow(page, "gas 1")
    settle(page)
    seen = np.array(page.evaluate("window.seen"))
    assert page.evaluate("medjaxPlayer.clock.playing") == playing
    before = seen[seen < 1600.0]  # along the MED's way, and at the start of the camera's
    assert before.size >= 1
    assert seen[-1] > 2500.0


def test_the_camera_glides_to_an_event_of_another_time_and_place(pages, driving):
    page = pages(driving, glides=True)
    page.evaluate("medjaxPlayer.setCamera('free', 1000)")
    settle(page)
    first, after = page.evaluate(
        """() => {
          const player = medjaxPlayer;
          player.events.go({ seconds: 19, which: 0, x: 3200 });
          player._show(19);
          const { center } = player.views[0].road;
          return [center, player.gaze.behind];
        }"""
    )
    assert first < 1600.0
    assert after < -1000.0
    settle(page)
    assert page.evaluate("medjaxPlayer.views[0].road.center") == 3200.0


def test_reduced_motion_cuts_instead_of_gliding(pages, driving):
    page = pages(driving)
    page.evaluate("medjaxPlayer.setCamera('free', 1000)")
    settle(page)
    page.evaluate("medjaxPlayer.setCamera('free', 3000); medjaxPlayer._show(0)")
    assert page.evaluate("medjaxPlayer.views[0].road.center") == 3000.0


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    """Two policies: the MED of one starts at 1000 m, that of the other at 2500 m, where it charges an EV later."""
    pair = []
    for name, x in (("early", 1000.0), ("late", 2500.0)):
        recording = blank(1 + 4 * 40)
        put(recording, 0, x, 2, speed=22.0)
        put(recording, recording.config.ev_slots.start, x - 5.0, 1, speed=22.0)
        recording.frames.med_status[:, 0] = IN_SERVICE
        pair.append(dataclasses.replace(recording, policy=name))
    pair[1].frames.ev_med[80:, 0] = 0
    pair[1].frames.ev_is_charging[80:, 0] = True
    path = tmp_path_factory.mktemp("apart") / "apart.html"
    write_player(path, pair)
    return path


@pytest.mark.parametrize(
    "look",
    [
        "player.setCamera('auto')",
        "player.setCamera('free', 1800)",
        "player.select(1, player.episodes[1].tracks[0]); player.setCamera('selected')",
        "player.events.step(0, 1)",
        "player.setZoom(1)",
    ],
)
@pytest.mark.parametrize("glides", [False, True])
def test_both_roads_show_one_stretch_at_every_time(pages, apart, look, glides):
    page = pages(apart, glides=glides)
    seen = page.evaluate(
        f"""() => {{
          const player = medjaxPlayer;
          {look};
          return Array.from({{ length: 81 }}, (_, i) => {{
            player._show(i / 2);
            return player.views.map(({{ road: {{ camera }} }}) => [camera.start, camera.span, camera.topY]);
          }});
        }}"""
    )
    first, second = np.moveaxis(np.array(seen), 1, 0)
    np.testing.assert_array_equal(first, second)


def test_the_shared_camera_goes_to_the_med_that_charges(pages, apart):
    """It leaves the first policy's MED for the other's, which is busier."""
    page = pages(apart)
    x = [
        page.evaluate(f"medjaxPlayer._show({time}), medjaxPlayer.views[0].road.center")
        for time in (5, 30)
    ]
    np.testing.assert_allclose(x, [1000.0 + 22.0 * 5, 2500.0 + 22.0 * 30], atol=0.1)
