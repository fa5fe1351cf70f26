"""Where the camera looks: at a vehicle, at a place, or at the busiest MED."""

import contextlib
import dataclasses
import math
import re
from collections.abc import Sequence

import numpy as np

from medjax.episodes.recording import Recording
from medjax.errors import InputError, shown
from medjax.render.layout import SIZE
from medjax.render.roadway import Roadway
from medjax.render.scene import Scene, Timeline
from medjax.render.tracks import Track
from medjax.world.kinds import CLASSES

AUTO = "auto"  # follows the MED that charges most EVs
HOLD_S = 10.0  # least time with one MED before the camera moves to a busier one
FORMS = "auto, MED:NUMBER, EV:NUMBER, gas:NUMBER, or a position in m"


@dataclasses.dataclass(frozen=True)
class Shot:
    """Which part of a recording is filmed, and how."""

    follow: str = AUTO  # see `camera_path`
    start_s: float | None = None  # None: the start for .mp4, else where most EVs charge
    duration_s: float | None = None  # None: to the end for .mp4, 20 s for .gif
    width: int = SIZE[0]  # px
    height: int = SIZE[1]
    span_m: float | None = None  # length of road in view; None derives it from the lane height


def busiest_place(scene: Scene, road: Roadway) -> float:
    """Position of the MED that charges most EVs, m; the middle of the road if there is no MED."""
    meds = scene.active[: scene.num_meds]
    if not meds.any():
        return 0.5 * road.length_m
    busy = np.bincount(scene.ev_med[scene.ev_is_charging], minlength=len(meds))
    best = int(np.argmax(np.where(meds, 1 + busy, 0)))
    return float(scene.x[best])


def busiest_time(timeline: Timeline) -> float:
    """The first time at which the number of charging EVs peaks, s."""
    recording = timeline.recording
    on_road = recording.frames.active[:, recording.config.ev_slots]
    charging = (recording.frames.ev_is_charging & on_road).sum(axis=1)
    return float(recording.time_s[np.argmax(charging)])


def camera_path(timeline: Timeline, follow: str) -> np.ndarray:
    """Middle of the camera's stretch at each frame, `(F,)` m.

    Before a followed vehicle enters, and after it leaves, the camera stays where it enters or leaves.
    `auto` is `auto_path`.

    Raises:
      InputError: one line; `follow` names nothing in the recording.
    """
    if follow == AUTO:
        return auto_path([timeline])
    x, x_m = timeline.recording.frames.x, as_number(follow)
    if math.isnan(x_m):
        track = find_track(timeline, follow)
        frames = np.clip(np.arange(len(x)), track.first, track.last)
        return np.asarray(x[frames, track.slot], np.float64)
    if not 0.0 <= x_m <= timeline.roadway.length_m:
        raise InputError(f"follow = {follow}: allowed 0 to {timeline.roadway.length_m:g} m")
    return np.full(len(x), x_m)


def check_follow(text: str) -> None:
    """Raises InputError for a text that no recording can follow."""
    if text != AUTO and vehicle_named(text) is None and not math.isfinite(as_number(text)):
        raise InputError(f"follow = {shown(text)}: allowed {FORMS}")


def as_number(text: str) -> float:
    """Parses a number; nan if the text is not one or is not ASCII."""
    with contextlib.suppress(ValueError):
        return float(text) if text.isascii() else math.nan
    return math.nan


def vehicle_named(text: str) -> tuple[str, int] | None:
    """Class and number of a name such as `ev:27`, which need not exist; None if it is no vehicle's name."""
    found = re.fullmatch(r"([A-Za-z]+)[: ]?([0-9]{1,9})", text.strip())
    names = {name.lower(): name for name in CLASSES}
    if found is None or found[1].lower() not in names:
        return None
    return names[found[1].lower()], int(found[2])


def find_track(timeline: Timeline, text: str) -> Track:
    """The vehicle of a name such as `MED:3`; raises InputError if there is none."""
    check_follow(text)
    kind, number = vehicle_named(text) or ("", 0)
    same = [track for track in timeline.tracks if track.kind == kind]
    if 1 <= number <= len(same):
        return same[number - 1]
    allowed = f"1 to {len(same)}" if same else f"none, for there is no {kind} in this episode"
    raise InputError(f"follow = {text}: allowed {kind} numbers: {allowed}")


def auto_path(timelines: Sequence[Timeline]) -> np.ndarray:
    """One camera for all recordings of an episode: the middle of its stretch at each frame, `(F,)` m.

    The camera follows the MED that charges most EVs, in whichever recording, and stays for at least HOLD_S. While no
    MED is on the road, the camera waits where the next one will enter.
    """
    recordings = [each.recording for each in timelines]
    meds = recordings[0].config.med_slots
    on_road = np.concatenate([np.asarray(each.frames.active)[:, meds] for each in recordings], 1)
    x = np.concatenate([np.asarray(each.frames.x)[:, meds] for each in recordings], 1)
    hold = round(HOLD_S / recordings[0].config.tick_s)
    path = np.full(len(x), np.nan)
    followed, since = -1, 0
    for frame in np.nonzero(on_road.any(axis=1))[0].tolist():
        there = on_road[frame]
        gone = followed < 0 or not there[followed]
        if gone or frame >= since + hold:
            charged = np.concatenate([_charged(recording, frame) for recording in recordings])
            busy = np.where(there, 1 + charged, 0)
            if gone or busy.max() > busy[followed]:
                followed, since = int(busy.argmax()), frame
        path[frame] = x[frame, followed]
    known = np.nonzero(np.isfinite(path))[0]
    if not known.size:
        return np.full(len(x), 0.5 * timelines[0].roadway.length_m)
    following = known[np.minimum(np.searchsorted(known, np.arange(len(x))), known.size - 1)]
    return path[following]


def _charged(recording: Recording, frame: int) -> np.ndarray:
    """How many EVs each MED charges, `(num_meds,)`."""
    frames = recording.frames
    med = np.asarray(frames.ev_med)[frame][np.asarray(frames.ev_is_charging)[frame]]
    return np.bincount(med, minlength=recording.config.num_meds)
