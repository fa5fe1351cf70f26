"""The player in headless Chromium: a vehicle that an incident makes stand."""

import numpy as np
import pytest

from medjax.render.player import write_player
from medjax.render.tracks import broken_down
from tests.render.browser import opened, settle
from tests.render.made import blank, put


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Gas 1 breaks down at 4 s in lane 2 and drives on at 12 s."""
    recording = blank(1 + 4 * 20)
    put(recording, recording.config.gas_slots.start, 100.0, 1)
    recording.frames.gas_is_broken_down[16:48, 0] = True
    path = tmp_path_factory.mktemp("broken") / "broken.html"
    write_player(path, [recording], start_s=0.0)
    return path


def yellow(page):
    """Pixels of the warning's colour in the road's picture."""
    return page.evaluate(
        """() => {
          const canvas = document.querySelector("#views canvas");
          const copy = new OffscreenCanvas(canvas.width, canvas.height);
          const context = copy.getContext("2d", { willReadFrequently: true });
          context.drawImage(canvas, 0, 0);
          const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
          let count = 0;
          for (let i = 0; i < data.length; i += 4)
            count += data[i] === 0xf0 && data[i + 1] === 0xc0 && data[i + 2] === 0;
          return count;
        }"""
    )


def test_a_broken_down_vehicle_is_marked_while_it_stands(browser, broken):
    with opened(browser, broken) as page:
        texts = page.locator("#event-list li").all_inner_texts()
        assert "0:04 gas 1 breaks down" in texts
        assert "0:12 gas 1 drives on" in texts
        assert page.locator("#broken-down").is_visible()
        seen = []
        for time in (2.0, 8.0, 15.0):
            page.evaluate(f"medjaxPlayer.setCamera('free', 100); medjaxPlayer.seek({time})")
            settle(page)
            seen.append(yellow(page))
        assert seen[0] == seen[2] == 0 < seen[1]


def test_the_legend_is_silent_without_incidents(browser, tmp_path):
    write_player(tmp_path / "none.html", [blank(1 + 4 * 4)])
    with opened(browser, tmp_path / "none.html") as page:
        assert not page.locator("#broken-down").is_visible()


def test_without_incidents_nobody_is_told(recording):
    told = np.asarray(recording.frames.gas_is_broken_down)
    assert told.shape == (len(recording.time_s), recording.config.num_gas)
    assert not told.any()


def test_the_recording_tells_who_stands(freight):
    """One incident at 100 s for 120 s: a vehicle brakes, stands as long and drives on; no other is told."""
    frames, config = freight.frames, freight.config
    ((slot, first, after),) = broken_down(freight)
    assert 100.0 <= freight.time_s[first] <= 101.0
    told = np.asarray(frames.gas_is_broken_down)
    assert told[first:after, slot - config.gas_slots.start].all()
    assert told.sum() == after - first
    speed = np.asarray(frames.speed)[:, slot]
    assert (speed[first:after] <= 0.0).sum() * config.tick_s == pytest.approx(120.0, abs=0.5)
    assert speed[after + 8] > 0.0
