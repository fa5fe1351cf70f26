"""A recording as .mp4, .gif or .png, at true speed.

Every physics tick gets a picture, and interpolated pictures between ticks bring the rate to about 20 a second
(`Timeline.at`). A tick of 0.25 s gives 5 pictures, 0.05 s apart, which a GIF's clock of 1/100 s shows exactly.
"""

import dataclasses
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from medjax.episodes.recording import Recording
from medjax.errors import InputError
from medjax.files import replacing
from medjax.render.camera import AUTO, Shot, busiest_place, busiest_time, camera_path
from medjax.render.encoder import encode, ffmpeg_program
from medjax.render.frame import draw
from medjax.render.scene import Timeline

SMOOTH_HZ = 20.0  # approximate pictures per second
EXCERPT_S = 20.0  # default length of a GIF, short because GIFs are large
FASTEST_M_PER_S = 100.0  # faster than any vehicle
PALETTE_PICTURES = 8  # sampled for the 256 colours of a GIF; all pictures use the same few colours
AS_FITS = Shot()


def per_tick(tick_s: float) -> int:
    """Pictures per physics tick."""
    return max(1, round(SMOOTH_HZ * tick_s))


def picture_times(timeline: Timeline, start_s: float, duration_s: float) -> np.ndarray:
    """Times of all pictures, s, the first one on a tick."""
    recording = timeline.recording
    tick_s, pictures = recording.config.tick_s, per_tick(recording.config.tick_s)
    first = timeline.frame_at(start_s)
    ticks = max(1, round(min(duration_s, timeline.duration_s - first * tick_s) / tick_s))
    return (first + np.arange(ticks * pictures) / pictures) * tick_s


def write_png(path: Path, recording: Recording, shot: Shot = AS_FITS) -> None:
    """Writes one picture, of the time `shot.start_s`.

    Raises:
      InputError: the size, time or vehicle is not allowed.
      OSError: path cannot be written.
    """
    from PIL import Image

    timeline = Timeline(recording)
    time = busiest_time(timeline) if shot.start_s is None else _checked(timeline, shot.start_s)
    place = camera_path(timeline, shot.follow)[timeline.frame_at(time)]
    if shot.follow == AUTO:
        place = busiest_place(timeline.at(time), timeline.roadway)
    picture = _picture(timeline, shot, time, float(place))
    with replacing(path) as partial:
        Image.fromarray(picture).save(partial, "PNG", optimize=True)


def write_video(path: Path, recording: Recording, shot: Shot = AS_FITS) -> None:
    """Writes .mp4 (H.264) or .gif by the ending of path; a terminal shows a progress bar.

    Raises:
      MissingLibrary: imageio-ffmpeg is not installed.
      InputError: the ending, size, time or vehicle is not allowed.
      OSError: path cannot be written.
    """
    from tqdm import tqdm

    ffmpeg_program()
    if path.suffix not in (".mp4", ".gif"):
        raise InputError(f"{path.name}: allowed .mp4, .gif")
    timeline = Timeline(recording)
    start, duration = _stretch(timeline, shot, whole=path.suffix == ".mp4")
    times = picture_times(timeline, start, duration)
    # yuv420p halves the resolution of colour, so sizes must be even.
    shot = dataclasses.replace(shot, width=shot.width // 2 * 2, height=shot.height // 2 * 2)
    rate = Fraction(per_tick(recording.config.tick_s)) / Fraction(str(recording.config.tick_s))
    some = times[np.linspace(0, len(times) - 1, PALETTE_PICTURES).round().astype(int)]
    samples = list(_pictures(timeline, shot, some)) if path.suffix == ".gif" else []
    bar = tqdm(times, desc=f"writing {path.name}", unit="frame", disable=None)
    size = (shot.width, shot.height)
    with replacing(path) as partial, encode(partial, rate, size, samples) as add:
        for picture in _pictures(timeline, shot, bar):
            add(picture)


def _pictures(timeline: Timeline, shot: Shot, times: Iterable[float]) -> Iterator[np.ndarray]:
    path = camera_path(timeline, shot.follow)
    for time in times:
        yield _picture(timeline, shot, time, _place(timeline, path, time))


def _picture(timeline: Timeline, shot: Shot, time: float, place: float) -> np.ndarray:
    size = {"width": shot.width, "height": shot.height}
    return draw(timeline.at(time), timeline.roadway, place, span_m=shot.span_m, **size)


def _place(timeline: Timeline, path: np.ndarray, time: float) -> float:
    """Position of the camera between two ticks; it jumps to another MED instead of racing there."""
    now = timeline.frame_at(time)
    then = min(now + 1, len(path) - 1)
    tick_s = timeline.recording.config.tick_s
    moves = abs(path[then] - path[now]) < FASTEST_M_PER_S * tick_s
    share = time / tick_s - now if moves else 0.0
    return float(path[now] + share * (path[then] - path[now]))


def _checked(timeline: Timeline, start_s: float) -> float:
    if not 0.0 <= start_s <= timeline.duration_s:
        raise InputError(f"start = {start_s:g} s: allowed 0 to {timeline.duration_s:g} s")
    return start_s


def _stretch(timeline: Timeline, shot: Shot, *, whole: bool) -> tuple[float, float]:
    """Start and duration, s."""
    duration = shot.duration_s
    if duration is None:
        duration = timeline.duration_s if whole else EXCERPT_S
    if not duration > 0.0:
        raise InputError(f"duration = {duration:g} s: allowed (0, inf)")
    if shot.start_s is not None:
        return _checked(timeline, shot.start_s), duration
    if whole and shot.duration_s is None:
        return 0.0, duration
    latest = max(0.0, timeline.duration_s - duration)
    return min(max(0.0, busiest_time(timeline) - 0.5 * duration), latest), duration
