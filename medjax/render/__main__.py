"""The command `python -m medjax.render --policy NAME --out episode.mp4|.gif|.png|.html`.

Bad input is refused before anything is simulated, with exit code 2.
"""

import argparse
import dataclasses
import importlib.util
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from medjax.commandline import OneLineParser, as_path, command, fail, leave, whole_number
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.options import EpisodeRequest, add_episode_options, requested_episode
from medjax.episodes.recording import Recording
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError, MissingLibrary, shown
from medjax.files import check_output
from medjax.policies.policy import Policy
from medjax.render.camera import AUTO, FORMS, Shot, as_number, check_follow
from medjax.render.grid import SHOWN, pick, write_grid
from medjax.render.layout import check_size
from medjax.render.player import write_player
from medjax.render.story import (
    check_evaluation,
    known_evaluation,
    own_evaluation,
    read_evaluation,
)
from medjax.world.catalogue import PRESETS, KeepsLines
from medjax.world.params import EnvParams

PROG = "python -m medjax.render"
MOST = 1e9  # seconds or metres, beyond any episode or road
FOR_VIDEO = {"PIL": "Pillow", "imageio_ffmpeg": "imageio-ffmpeg", "tqdm": "tqdm"}
LIBRARIES = {".mp4": FOR_VIDEO, ".gif": FOR_VIDEO, ".png": {"PIL": "Pillow"}, ".html": {}}
"""The modules that each kind of file needs, with the names of their packages."""
SUFFIXES = ", ".join(LIBRARIES)


@dataclasses.dataclass(frozen=True)
class Request:
    """What to play and what to write."""

    out: Path
    played: EpisodeRequest
    shot: Shot
    evaluation: dict[str, Any] | None = None
    grid: int = 0  # number of episodes to choose three from; 0 shows the requested episode


def build_parser() -> OneLineParser:
    """Builds the parser. It leaves values as text, so that all errors are worded in one place."""
    parser = OneLineParser(
        prog=PROG,
        description="Plays an episode and writes it as a video, a picture or an HTML file with a player.",
        epilog=f"{PRESETS}\n\nExample: {PROG} --policy forecast --compare none --out episode.html",
        formatter_class=lambda prog: KeepsLines(prog, max_help_position=28, width=100),
    )
    play = parser.add_argument_group("what is played")
    add_episode_options(play)
    compare = "also play this policy, named as for --policy, on the same episode and show both; .html only"
    play.add_argument("--compare", metavar="NAME", help=compare)
    evaluation = (
        "file of train.evaluate --json, whose means are shown beside the episode's numbers; .html only "
        "(default: the evaluation of the run, or the known one of an unchanged preset)"
    )
    play.add_argument("--evaluation", metavar="FILE.json", help=evaluation)
    play.add_argument("--force", action="store_true", help="start even if memory is short")
    show = parser.add_argument_group("what is written")
    show.add_argument(
        "--out", metavar="FILE", required=True, help=f"file to write, ending in {SUFFIXES}"
    )
    follow = f"what the camera follows: {FORMS} (default: {AUTO}, the busiest MED)"
    show.add_argument("--follow", metavar="WHAT", default=AUTO, help=follow)
    start = "first second to show (default: .html at the first charge, a whole .mp4 at 0, others when most EVs charge)"
    show.add_argument("--start", metavar="S", help=start)
    duration = "seconds to show in .mp4 (default: to the end) or .gif (default: 20)"
    show.add_argument("--duration", metavar="S", help=duration)
    size = "size of video or picture in pixels (default: 1280x480)"
    show.add_argument("--size", metavar="WxH", default="1280x480", help=size)
    span = "metres of road that the camera shows (default: chosen to fit)"
    show.add_argument("--span", metavar="M", help=span)
    grid = "show the best, the median and the worst of N episodes instead of one; .html only"
    show.add_argument("--grid", metavar="N", help=grid)
    return parser


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
      argv: arguments; None uses those of the process.

    Returns:
      The exit code.
    """
    parser = build_parser()
    try:
        request = _request(parser.parse_args(argv))
    except InputError as error:
        parser.error(str(error))
    try:
        prepared = request.played.prepared()
        _check(request, *prepared)
        request.played.check_memory(*prepared, episodes=len(SHOWN) if request.grid else 1)
        env, params, chosen = request.played.build()
        request = dataclasses.replace(request, evaluation=_evaluation(request, env, list(chosen)))
        if request.grid:
            _write_grid(request, env, params, chosen)
        else:
            _write(request, request.played.record(env, params, chosen))
    except (InputError, OSError) as error:
        return fail(PROG, error)
    size = request.out.stat().st_size
    print(f"{request.out}: " + (f"{size / 1e6:.1f} MB" if size > 1e5 else f"{size / 1e3:.1f} kB"))
    return 0


def _request(given: argparse.Namespace) -> Request:
    """Checks the options as far as possible without an environment."""
    out = as_path("--out", given.out)
    if out.suffix not in LIBRARIES:
        raise InputError(f"--out {out}: allowed a file that ends in {SUFFIXES}")
    if out.suffix == ".html" and given.duration is not None:
        raise InputError(f"--duration with {out.name}: the player holds the whole episode")
    for option in ("compare", "evaluation", "grid"):
        if getattr(given, option) is not None and out.suffix != ".html":
            raise InputError(f"--{option} with {out.name}: allowed with a file that ends in .html")
    if given.grid is not None and given.episode != "0":
        raise InputError("--grid with --episode: allowed one of them")
    grid = 0 if given.grid is None else whole_number("--grid", given.grid, least=3, most=100_000)
    check_follow(given.follow)
    found = re.fullmatch("([0-9]{1,9})x([0-9]{1,9})", given.size)
    if found is None:
        raise InputError(f"--size {shown(given.size)}: allowed WIDTHxHEIGHT in px, as in 1280x480")
    width, height = int(found[1]), int(found[2])
    check_size(width, height)
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
    evaluation = given.evaluation and read_evaluation(as_path("--evaluation", given.evaluation))
    return Request(out, played, shot, evaluation, grid)


def _evaluation(
    request: Request, env: ChargingEnv, policies: Sequence[str]
) -> dict[str, Any] | None:
    """The given evaluation, else the run's own, else that of an unchanged preset; None if there is none."""
    if request.evaluation:
        overrides = env.recipe.overrides if env.recipe else {}
        check_evaluation(request.evaluation, env.name, policies, overrides)
    if request.evaluation or request.out.suffix != ".html":
        return request.evaluation
    played = request.played
    if played.evaluation is not None:
        return own_evaluation(played.evaluation, env.name, policies)
    changed = played.overrides or played.file
    return None if changed else known_evaluation(env.name, policies)


def _number(name: str, text: str | None, *, zero: bool = False) -> float | None:
    """The number that an option gives; None where it is not given. `zero` allows 0."""
    if text is None:
        return None
    value = as_number(text)
    if not 0.0 <= value <= MOST or (value == 0.0 and not zero):
        allowed = f"{'from' if zero else 'above'} 0 to {MOST:g}"
        raise InputError(f"--{name} {shown(text)}: allowed a number {allowed}")
    return value


def _check(request: Request, env: ChargingEnv, params: EnvParams) -> None:
    """Raises InputError for a place off the road or a time outside the episode."""
    follow, start_s = request.shot.follow, request.shot.start_s
    place_m, length_m = as_number(follow), float(params.road.length_m)  # nan names a vehicle
    seconds = int(params.episode_decisions) * env.config.decision_s
    if place_m < 0.0 or place_m > length_m:
        raise InputError(f"--follow {follow}: allowed 0 to {length_m:g} m")
    if start_s is not None and start_s > seconds:
        raise InputError(f"--start {start_s:g}: allowed 0 to {seconds:g} s")


def _write_grid(
    request: Request, env: ChargingEnv, params: EnvParams, chosen: Mapping[str, Policy]
) -> None:
    """Plays all episodes with the first policy, then replays three of them with all policies and writes these."""
    first, policy = next(iter(chosen.items()))
    print(f"compiling and playing {request.grid} episodes with {first} ...", file=sys.stderr)
    scores = evaluate_policies(env, params, {first: policy}, request.grid, request.played.seed)
    returns = np.asarray(scores[first]["return"])
    episodes = {
        name: dataclasses.replace(request.played, episode=episode).record(env, params, chosen)
        for name, episode in pick(returns).items()
    }
    write_grid(request.out, episodes, returns, **_opening(request))


def _write(request: Request, recordings: Sequence[Recording]) -> None:
    out = request.out
    if out.suffix == ".html":
        write_player(out, recordings, **_opening(request))
        return
    from medjax.render.video import write_png, write_video

    write = write_png if out.suffix == ".png" else write_video
    write(out, recordings[0], request.shot)


def _opening(request: Request) -> dict[str, Any]:
    """Keywords of `write_player`."""
    shot = request.shot
    return {"follow": shot.follow, "start_s": shot.start_s, "evaluation": request.evaluation}


if __name__ == "__main__":
    leave(main())
