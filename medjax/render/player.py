"""One recording, or two of the same episode, as one HTML file that plays in any browser without a network.

The page under `web/` is plain JavaScript; this module puts the recordings into it.
"""

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from medjax.episodes.recording import Recording
from medjax.errors import InputError
from medjax.files import replacing
from medjax.render import colors
from medjax.render.camera import AUTO, auto_path, camera_path, find_track, vehicle_named
from medjax.render.episode_data import pack_episode
from medjax.render.scene import Timeline
from medjax.render.story import ending, first_charge_s, means, verdict, words_for

# Each script may use those before it.
SCRIPTS = (
    "packing theme episode colours things road bodies charts vehicle dispatch events ways clock story "
    "player pointer input"
)


class Shown:
    """The player in a notebook; a cell that ends with it shows it."""

    def __init__(self, page: str, height: int) -> None:
        self.page, self.height = page, height

    def _repr_html_(self) -> str:
        """The page in a frame of its own; nothing is written or fetched."""
        frame = 'style="width: 100%; border: 1px solid #d4d8dd"'
        return f'<iframe srcdoc="{escape(self.page)}" height="{self.height}" {frame}></iframe>'


def show(*recordings: Recording, height: int = 860, **how: Any) -> Shown:
    """The player of one recording, or of two of the same episode, for a notebook.

    Args:
      recordings: as in `write_player`.
      height: px.
      how: `follow`, `start_s` and `evaluation` of `write_player`.
    """
    return Shown(player_page(recordings, **how), height)


def write_player(
    path: Path,
    recordings: Sequence[Recording],
    *,
    follow: str = AUTO,
    start_s: float | None = None,
    evaluation: Mapping[str, Any] | None = None,
) -> None:
    """Writes the player.

    Args:
      path: file to write, in full or not at all.
      recordings: one, or those of two policies in the same episode, which then share one clock and one camera.
      follow: what to follow in the first recording at the start, as in `camera_path`.
      start_s: initial time of the clock; None is just before an EV is first charged.
      evaluation: of many episodes, shown as means beside this episode (`medjax.render.story.read_evaluation`).

    Raises:
      InputError: one line; the recordings are of different episodes, or there is no such vehicle or time.
      OSError: path cannot be written.
    """
    page = player_page(recordings, follow=follow, start_s=start_s, evaluation=evaluation)
    with replacing(path) as partial:
        partial.write_text(page, encoding="utf-8")


def player_page(
    recordings: Sequence[Recording],
    *,
    follow: str = AUTO,
    start_s: float | None = None,
    evaluation: Mapping[str, Any] | None = None,
) -> str:
    """The text of the page; see `write_player`."""
    check_comparable(recordings)
    timelines = [Timeline(recording) for recording in recordings]
    start_s = first_charge_s(recordings) if start_s is None else start_s
    if not 0.0 <= start_s <= timelines[0].duration_s:
        raise InputError(f"start = {start_s:g} s: allowed 0 to {timelines[0].duration_s:g} s")
    camera = auto_path(timelines)
    packed = [pack_episode(timeline, camera) for timeline in timelines]
    head = recordings[0]
    data = {
        "episodes": [meta for meta, _ in packed],
        "words": [words_for(recording.policy) for recording in recordings],
        "socScale": list(map(colors.css, colors.SOC_SCALE)),
        "start": start_s,
        "verdict": verdict(recordings),
        "ending": ending(recordings, evaluation),
        "means": means(evaluation, recordings) if evaluation else [],
        "evaluated": evaluation["episodes"] if evaluation else 0,
        "follow": _follow(timelines[0], follow),
    }
    policies = " and ".join(recording.policy for recording in recordings)
    where = f"seed {head.seed}, episode {head.episode}"
    web = resources.files("medjax.render") / "web"
    script = "\n".join((web / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS.split())
    blobs = "\n".join(
        f'<script type="text/plain" id="data-{number}">{text}</script>'
        for number, (_, text) in enumerate(packed)
    )
    parts = {
        "TITLE": escape(f"{head.scenario}: {policies}, {where}"),
        "HEADING": escape(f"Charging cars as they drive: {policies}"),
        "WHERE": escape(f"{head.scenario}, {where}"),
        "STYLE": _root_style() + (web / "player.css").read_text(encoding="utf-8"),
        "META": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "DATA": blobs,
        "SCRIPT": script,
    }
    page = (web / "player.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"<!--{name}-->", text)
    return page


def check_comparable(recordings: Sequence[Recording]) -> None:
    """Raises InputError unless there is one recording, or two of the same episode of the same world."""
    if not 1 <= len(recordings) <= 2:
        raise InputError(f"{len(recordings)} recordings: allowed 1 or 2")
    first, last = recordings[0], recordings[-1]
    for name in ("scenario", "seed", "episode", "config"):
        a, b = getattr(first, name), getattr(last, name)
        if a != b:
            raise InputError(f"{name} is {a} and {b}: allowed two recordings of the same episode")
    if (a := len(first.frames.x)) != (b := len(last.frames.x)):
        raise InputError(f"{a} and {b} frames: allowed episodes of one length")


def _follow(timeline: Timeline, follow: str) -> dict[str, Any]:
    """The vehicle or place that the camera starts with."""
    path = camera_path(timeline, follow)  # refuses a vehicle or place that does not exist
    if vehicle_named(follow):
        return {"mode": "selected", "track": timeline.tracks.index(find_track(timeline, follow))}
    return {"mode": "auto"} if follow == AUTO else {"mode": "free", "x": float(path[0])}


def _root_style() -> str:
    """The colours as CSS properties, some of which the style sheet overrides in dark mode."""
    names = {
        "paper": colors.PAPER,
        "ink": colors.INK,
        "faint": colors.FAINT_INK,
        "grass": colors.GRASS,
        "asphalt": colors.ASPHALT,
        "marking": colors.MARKING,
        "edge": colors.EDGE,
        "med": colors.MED_COLOR,
        "gas": colors.GAS_COLOR,
        "out": colors.RAN_OUT,
        "accent": colors.ACCENT,
    }
    values = {name: colors.css(color) for name, color in names.items()}
    values["soc"] = f"linear-gradient(to right, {', '.join(map(colors.css, colors.SOC_SCALE))})"
    lines = "\n".join(f"  --{name}: {value};" for name, value in values.items())
    return f":root {{\n{lines}\n}}\n"
