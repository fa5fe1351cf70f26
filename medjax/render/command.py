"""The command line of `python -m medjax.render`: what is asked for, refused before anything is simulated."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import math
import re
from collections.abc import Sequence
from pathlib import Path

from medjax.commandline import as_path
from medjax.episodes.options import EpisodeRequest, requested_episode
from medjax.errors import InputError, MissingLibrary, shown
from medjax.files import check_output
from medjax.render.camera import check_follow
from medjax.render.options import SUFFIXES, build_parser

MOST = 1e9  # seconds or metres: more than there are
LIBRARIES: dict[str, dict[str, str]] = {
    ".mp4": {"PIL": "Pillow", "imageio_ffmpeg": "imageio-ffmpeg", "tqdm": "tqdm"},
    ".gif": {"PIL": "Pillow", "imageio_ffmpeg": "imageio-ffmpeg", "tqdm": "tqdm"},
    ".png": {"PIL": "Pillow"},
    ".html": {},
}
"""What each kind of file is written with: module, and name of the package."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What to play and what to write; checked as far as that needs no environment."""

    out: Path
    played: EpisodeRequest
    follow: str
    start_s: float | None
    duration_s: float | None
    width: int
    height: int
    span_m: float | None

    @property
    def place_m(self) -> float | None:
        """Where the camera stands; None where it follows a vehicle."""
        place = _float(self.follow)
        return None if math.isnan(place) else place


def parse_request(argv: Sequence[str] | None = None) -> Request:
    """The request that `argv` makes; bad input ends the command with exit code 2."""
    parser = build_parser()
    given = parser.parse_args(argv)
    try:
        return _request(given)
    except InputError as error:
        parser.error(str(error))


def _request(given: argparse.Namespace) -> Request:
    out = as_path("--out", given.out)
    if out.suffix not in SUFFIXES:
        raise InputError(f"--out {out}: allowed a file that ends in {', '.join(SUFFIXES)}")
    if given.compare is not None and out.suffix != ".html":
        raise InputError(f"--compare with {out.name}: allowed with a file that ends in .html")
    if out.suffix == ".html" and given.duration is not None:
        raise InputError(f"--duration with {out.name}: the player holds the whole episode")
    check_follow(given.follow)
    width, height = _size(given.size)
    request = Request(
        out=out,
        played=requested_episode(given),
        follow=given.follow,
        start_s=_number("start", given.start, least=0.0),
        duration_s=_number("duration", given.duration, above=0.0),
        width=width,
        height=height,
        span_m=_number("span", given.span, above=0.0),
    )
    _check_libraries(out.suffix)
    check_output("--out", out)
    return request


def _check_libraries(suffix: str) -> None:
    for module, library in LIBRARIES[suffix].items():
        if importlib.util.find_spec(module) is None:
            raise InputError(str(MissingLibrary(library)))


def _size(text: str) -> tuple[int, int]:
    from medjax.render.layout import check_size

    found = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", text)
    if found is None:
        raise InputError(f"--size {shown(text)}: allowed WIDTHxHEIGHT in px, as in 1280x480")
    width, height = int(found[1]), int(found[2])
    check_size(width, height)
    return width, height


def _number(
    name: str, text: str | None, *, least: float | None = None, above: float | None = None
) -> float | None:
    if text is None:
        return None
    allowed = f"from {least:g}" if least is not None else f"above {above:g}"
    value = _float(text)
    fits = value >= least if least is not None else value > (above or 0.0)
    if not fits or value > MOST:
        raise InputError(f"--{name} {shown(text)}: allowed a number {allowed} to {MOST:g}")
    return value


def _float(text: str) -> float:
    """The number that a text is; nan if it is none, or in the digits of another script."""
    try:
        return float(text) if text.isascii() else math.nan
    except ValueError:
        return math.nan
