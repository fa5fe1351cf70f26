"""Where the camera looks: a vehicle, a place, or wherever most is going on."""

from __future__ import annotations

import math
import re

import numpy as np

from medjax.errors import InputError, shown
from medjax.render.roadway import Roadway
from medjax.render.scene import Scene, Timeline
from medjax.render.tracks import Track
from medjax.world.kinds import CLASSES

AUTO = "auto"
HOLD_S = 10.0  # that the camera stays with a MED before it goes to a busier one
FORMS = "auto, MED:NUMBER, EV:NUMBER, gas:NUMBER, or a position in m"


def busiest_place(scene: Scene, road: Roadway) -> float:
    """Where the MED is that charges most EVs, m; the middle of the road where there is none."""
    meds = scene.active[: scene.num_meds]
    if not meds.any():
        return 0.5 * road.length_m
    busy = np.bincount(scene.ev_med[scene.ev_is_charging], minlength=len(meds))
    best = int(np.argmax(np.where(meds, 1 + busy, 0)))
    return float(scene.x[best])


def busiest_time(timeline: Timeline) -> float:
    """The first time at which most EVs charge, s."""
    recording = timeline.recording
    on_road = recording.frames.active[:, recording.config.ev_slots]
    charging = (recording.frames.ev_is_charging & on_road).sum(axis=1)
    return float(recording.time_s[np.argmax(charging)])


def camera_path(timeline: Timeline, follow: str) -> np.ndarray:
    """Middle of the camera's stretch at each frame, `(F,)` m.

    A vehicle that has not come yet or is gone is waited for, or looked after, where it came or went.
    With `auto` it is with the MED that charges most EVs, for HOLD_S at least.

    Raises:
      InputError: one line, `follow` names nothing that there is.
    """
    count = len(timeline.recording.frames.x)
    if follow == AUTO:
        return _auto_path(timeline)
    try:
        place = float(follow)
    except ValueError:
        return _track_path(timeline, find_track(timeline, follow))
    if not 0.0 <= place <= timeline.roadway.length_m:
        raise InputError(f"follow = {follow}: allowed 0 to {timeline.roadway.length_m:g} m")
    return np.full(count, place)


def check_follow(text: str) -> None:
    """Raises InputError for what can be followed in no recording."""
    if text == AUTO or _parts(text) is not None:
        return
    try:
        known = text.isascii() and math.isfinite(float(text))
    except ValueError:
        known = False
    if not known:
        raise InputError(f"follow = {shown(text)}: allowed {FORMS}")


def _parts(text: str) -> tuple[str, int] | None:
    """Class and number of `ev:27`."""
    found = re.fullmatch(r"([A-Za-z]+)[: ]?([0-9]{1,9})", text.strip())
    names = {name.lower(): name for name in CLASSES}
    if found is None or found[1].lower() not in names:
        return None
    return names[found[1].lower()], int(found[2])


def is_vehicle(follow: str) -> bool:
    """Whether `follow` names a vehicle, one that there is or not."""
    return _parts(follow) is not None


def find_track(timeline: Timeline, text: str) -> Track:
    """The vehicle that `MED:3` names; raises InputError where there is none."""
    check_follow(text)
    kind, number = _parts(text) or ("", 0)
    same = [track for track in timeline.tracks if track.kind == kind]
    for track in same:
        if track.number == number:
            return track
    allowed = f"1 to {len(same)}" if same else f"none, for there is no {kind} in this episode"
    raise InputError(f"follow = {text}: allowed {kind} numbers: {allowed}")


def _track_path(timeline: Timeline, track: Track) -> np.ndarray:
    x = timeline.recording.frames.x[:, track.slot]
    frames = np.arange(len(x))
    return np.asarray(x[np.clip(frames, track.first, track.last)], np.float64)


def _auto_path(timeline: Timeline) -> np.ndarray:
    """With the MED that charges most, for HOLD_S at least; before one comes, it waits where the next one will."""
    recording = timeline.recording
    frames, meds = recording.frames, recording.config.med_slots
    on_road, x = np.asarray(frames.active)[:, meds], np.asarray(frames.x)[:, meds]
    numbers = np.arange(recording.config.num_meds)
    hold = round(HOLD_S / recording.config.tick_s)
    path = np.full(len(x), np.nan)
    followed, since = -1, 0
    for frame in np.nonzero(on_road.any(axis=1))[0].tolist():
        there = on_road[frame]
        gone = followed < 0 or not there[followed]
        if gone or frame >= since + hold:
            charged = frames.ev_med[frame][frames.ev_is_charging[frame]]
            busy = np.where(there, 1 + (charged[:, None] == numbers).sum(axis=0), 0)
            if gone or busy.max() > busy[followed]:
                followed, since = int(busy.argmax()), frame
        path[frame] = x[frame, followed]
    known = np.nonzero(np.isfinite(path))[0]
    if not known.size:
        return np.full(len(x), 0.5 * timeline.roadway.length_m)
    following = known[np.minimum(np.searchsorted(known, np.arange(len(x))), known.size - 1)]
    return path[following]
