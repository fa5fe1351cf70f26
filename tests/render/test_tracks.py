"""Tracks of vehicles against the episode's tally, and the camera's path along them."""

import numpy as np
import pytest

from medjax.episodes.recording import record_episode
from medjax.policies.rules import BASELINES
from medjax.render.camera import AUTO, auto_path, busiest_time, camera_path, find_track
from medjax.render.scene import Timeline
from medjax.render.tracks import ran_out, tracks_of
from medjax.world.kinds import by_class
from tests.compiling import quickly


def test_tracks_are_those_of_the_tally(recording):
    """As many of each class, and as many EVs without energy, without overlaps in a slot."""
    tracks, active = tracks_of(recording), recording.frames.active
    config = recording.config
    slices = (config.med_slots, config.ev_slots, config.gas_slots)
    at_start = [active[0, slots].sum() for slots in slices]
    entered = by_class(recording.decisions.stats.entered.sum(axis=0)) + at_start
    numbers = [[t.number for t in tracks if t.kind == kind] for kind in ("MED", "EV", "gas")]
    assert [len(n) for n in numbers] == list(entered)
    assert all(sorted(n) == list(range(1, len(n) + 1)) for n in numbers)
    covered = np.zeros(active.shape, int)
    for track in tracks:
        covered[track.first : track.last + 1, track.slot] += 1
    np.testing.assert_array_equal(covered, active)
    stops = ran_out(recording)
    assert len(stops) == recording.decisions.stats.depleted.sum() > 0
    assert all(0.0 <= stop.x_m <= 4000.0 for stop in stops)


def test_positions_between_ticks_are_interpolated(recording):
    timeline = Timeline(recording)
    before, between, after = (timeline.at(time) for time in (30.0, 30.125, 30.25))
    stays = before.active & after.active
    middle = 0.5 * (before.x + after.x)
    np.testing.assert_allclose(between.x[stays], middle[stays], atol=1e-3)
    np.testing.assert_array_equal(before.x, recording.frames.x[120])


def test_the_camera_stays_on_the_followed_vehicle(recording):
    timeline = Timeline(recording)
    track = find_track(timeline, "ev:2")
    path = camera_path(timeline, "EV 2")
    stay = slice(track.first, track.last + 1)
    np.testing.assert_array_equal(path[stay], recording.frames.x[stay, track.slot])
    assert np.all(path[track.last :] == path[track.last])


def test_the_automatic_camera_is_at_a_med_whenever_there_is_one(recording):
    path, frames = camera_path(Timeline(recording), AUTO), recording.frames
    meds = recording.config.med_slots
    any_med = frames.active[:, meds].any(axis=1)
    assert any_med.any()
    off = np.where(frames.active[:, meds], np.abs(frames.x[:, meds] - path[:, None]), np.inf)
    assert np.all(off.min(axis=1)[any_med] == 0.0)


def test_recordings_share_the_camera_of_the_one_with_meds(recording, other):
    alone = auto_path([Timeline(recording)])
    assert np.ptp(alone) > 100.0
    for pair in ([recording, other], [other, recording]):
        np.testing.assert_array_equal(auto_path([Timeline(each) for each in pair]), alone)


@pytest.fixture(scope="module")
def changing(world):
    """An episode in which one MED after the other is the busiest."""
    env, params = world
    with quickly():
        return record_episode(env, params, BASELINES["periodic"](env), seed=3, episode=17)


@pytest.mark.thorough
def test_the_camera_leaves_a_med_for_a_busier_one_within_ten_seconds(changing):
    path, frames, meds = camera_path(Timeline(changing), AUTO), changing.frames, range(3)
    charged = [(frames.ev_is_charging & (frames.ev_med == med)).sum(axis=1) for med in meds]
    busy = np.where(frames.active[:, :3], np.stack(charged, axis=1), -1)
    followed = np.where(frames.active[:, :3] & (frames.x[:, :3] == path[:, None]), busy, -1)
    behind = busy.max(axis=1) > followed.max(axis=1)
    switches = np.nonzero(np.abs(np.diff(path)) > 25.0)[0]
    assert len(switches)
    longest = max(map(len, "".join("x" if b else " " for b in behind).split()), default=0)
    assert longest <= 40  # ticks


def test_most_evs_charge_when_it_is_busiest(recording):
    timeline, charging = Timeline(recording), recording.frames.ev_is_charging.sum(axis=1)
    assert charging.max() > 0
    assert charging[timeline.frame_at(busiest_time(timeline))] == charging.max()
