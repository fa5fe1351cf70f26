"""The command `python -m medjax.render --policy NAME | --run-dir DIR --out episode.mp4|.gif|.png|.html`.

Exit code 2 on bad input.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from medjax.commandline import fail
from medjax.errors import InputError
from medjax.render.command import Request, parse_request
from medjax.render.options import PROG

if TYPE_CHECKING:
    from medjax.env.charging_env import ChargingEnv
    from medjax.episodes.recording import Recording
    from medjax.world.params import EnvParams


def main(argv: Sequence[str] | None = None) -> int:
    """Does what the command line says.

    Args:
      argv: arguments; None takes those of the process.

    Returns:
      The exit code.
    """
    request = parse_request(argv)
    try:
        _check(request, *request.played.prepared())
        env, params, chosen = request.played.policies()
    except (InputError, OSError) as error:
        return fail(PROG, error)
    try:
        recordings = request.played.record(env, params, chosen)
        try:
            _write(request, recordings)
        except (InputError, OSError) as error:  # a vehicle that never came, a disk that is full
            return fail(PROG, error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    print(f"{request.out}: {request.out.stat().st_size / 1e6:.1f} MB")
    return 0


def _check(request: Request, env: ChargingEnv, params: EnvParams) -> None:
    """Raises InputError for a place or time that the episode will not have."""
    length_m = float(params.road.length_m)
    seconds = int(params.episode_decisions) * env.config.decision_s
    if request.place_m is not None and not 0.0 <= request.place_m <= length_m:
        raise InputError(f"--follow {request.follow}: allowed 0 to {length_m:g} m")
    if request.start_s is not None and request.start_s > seconds:
        raise InputError(f"--start {request.start_s:g}: allowed 0 to {seconds:g} s")


def _write(request: Request, recordings: Sequence[Recording]) -> None:
    if request.out.suffix == ".html":
        from medjax.render.player import write_player

        write_player(request.out, recordings, follow=request.follow, start_s=request.start_s or 0.0)
        return
    from medjax.render.video import Shot, write_png, write_video

    shot = Shot(
        follow=request.follow,
        start_s=request.start_s,
        duration_s=request.duration_s,
        width=request.width,
        height=request.height,
        span_m=request.span_m,
    )
    write = write_png if request.out.suffix == ".png" else write_video
    write(request.out, recordings[0], shot)


if __name__ == "__main__":
    sys.exit(main())
