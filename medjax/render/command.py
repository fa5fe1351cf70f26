"""The command line of `python -m medjax.render`: what is asked for, refused before anything is simulated."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path

from medjax.commandline import OneLineParser, as_path
from medjax.episodes.options import EpisodeRequest, add_episode_options, requested_episode
from medjax.errors import InputError, MissingLibrary, shown
from medjax.files import check_output
from medjax.render.camera import AUTO, FORMS, Shot, as_number, check_follow
from medjax.render.layout import check_size

PROG = "python -m medjax.render"
MOST = 1e9  # seconds or metres: more than there are
FOR_VIDEO = {"PIL": "Pillow", "imageio_ffmpeg": "imageio-ffmpeg", "tqdm": "tqdm"}
LIBRARIES = {".mp4": FOR_VIDEO, ".gif": FOR_VIDEO, ".png": {"PIL": "Pillow"}, ".html": {}}
"""What each kind of file is written with: module, and name of the package."""
SUFFIXES = ", ".join(LIBRARIES)


@dataclasses.dataclass(frozen=True)
class Request:
    """What to play and what to write; checked as far as that needs no environment."""

    out: Path
    played: EpisodeRequest
    shot: Shot


def build_parser() -> OneLineParser:
    """The parser; values stay text here, so that all errors are worded in one place."""
    parser = OneLineParser(
        prog=PROG,
        description="Plays one episode and writes it as a video, a picture or a player in one HTML file.",
        epilog=f"Example: {PROG} --policy forecast --compare none --out episode.html",
        formatter_class=lambda prog: argparse.HelpFormatter(prog, max_help_position=28, width=100),
    )
    play = parser.add_argument_group("what is played")
    add_episode_options(play)
    beside = "a rule on the same episode beside it; .html"
    play.add_argument("--compare", metavar="NAME", help=beside)
    show = parser.add_argument_group("what is written")
    show.add_argument("--out", metavar="FILE", required=True, help=f"FILE ends in {SUFFIXES}")
    for name, metavar, default, text in (
        ("follow", "WHAT", AUTO, f"camera: {FORMS} (default: {AUTO}, the busiest MED)"),
        (
            *("start", "S", None),
            "first second shown (default: 0 for .html and a whole .mp4, else where most EVs charge)",
        ),
        ("duration", "S", None, "seconds of .mp4 (default: to the end) or .gif (default: 20)"),
        ("size", "WxH", "1280x480", "px, of video and picture (default: 1280x480)"),
        ("span", "M", None, "metres of road that the camera shows (default: as fits)"),
    ):
        show.add_argument(f"--{name}", metavar=metavar, default=default, help=text)
    return parser


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
    if out.suffix not in LIBRARIES:
        raise InputError(f"--out {out}: allowed a file that ends in {SUFFIXES}")
    if given.compare is not None and out.suffix != ".html":
        raise InputError(f"--compare with {out.name}: allowed with a file that ends in .html")
    if out.suffix == ".html" and given.duration is not None:
        raise InputError(f"--duration with {out.name}: the player holds the whole episode")
    check_follow(given.follow)
    width, height = _size(given.size)
    played = requested_episode(given)
    shot = Shot(
        follow=given.follow,
        start_s=_number("start", given.start, zero=True),
        duration_s=_number("duration", given.duration),
        width=width,
        height=height,
        span_m=_number("span", given.span),
    )
    for module, library in LIBRARIES[out.suffix].items():
        if importlib.util.find_spec(module) is None:
            raise InputError(str(MissingLibrary(library)))
    check_output("--out", out)
    return Request(out, played, shot)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", text)
    if found is None:
        raise InputError(f"--size {shown(text)}: allowed WIDTHxHEIGHT in px, as in 1280x480")
    width, height = int(found[1]), int(found[2])
    check_size(width, height)
    return width, height


def _number(name: str, text: str | None, *, zero: bool = False) -> float | None:
    """The number that an option gives, `zero` among what is allowed; None where it is not given."""
    if text is None:
        return None
    value = as_number(text)
    if not 0.0 <= value <= MOST or (value == 0.0 and not zero):
        allowed = f"{'from' if zero else 'above'} 0 to {MOST:g}"
        raise InputError(f"--{name} {shown(text)}: allowed a number {allowed}")
    return value
