"""The options of `python -m medjax.render`."""

from __future__ import annotations

import argparse

from medjax.commandline import OneLineParser
from medjax.episodes.options import add_episode_options
from medjax.render.camera import AUTO, FORMS

PROG = "python -m medjax.render"
SUFFIXES = (".mp4", ".gif", ".png", ".html")


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
    play.add_argument(
        "--compare", metavar="NAME", help="a rule on the same episode beside it; .html"
    )
    show = parser.add_argument_group("what is written")
    show.add_argument(
        "--out", metavar="FILE", required=True, help=f"FILE ends in {', '.join(SUFFIXES)}"
    )
    show.add_argument(
        "--follow",
        metavar="WHAT",
        default=AUTO,
        help=f"camera: {FORMS} (default: {AUTO}, the busiest MED)",
    )
    show.add_argument(
        "--start",
        metavar="S",
        help="first second shown (default: 0 for .html and a whole .mp4, else where most EVs charge)",
    )
    show.add_argument(
        "--duration",
        metavar="S",
        help="seconds of .mp4 (default: to the end) or .gif (default: 20)",
    )
    show.add_argument(
        "--size",
        metavar="WxH",
        default="1280x480",
        help="px, of video and picture (default: 1280x480)",
    )
    show.add_argument(
        "--span", metavar="M", help="metres of road that the camera shows (default: as fits)"
    )
    return parser
