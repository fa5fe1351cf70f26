"""The command `python -m medjax.render --policy NAME | --run-dir DIR --out episode.mp4|.gif|.png|.html`.

Exit code 2 on bad input.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from medjax.commandline import fail
from medjax.env.charging_env import ChargingEnv
from medjax.episodes.recording import Recording
from medjax.errors import InputError
from medjax.render.camera import as_number
from medjax.render.command import PROG, Request, parse_request
from medjax.render.player import write_player
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
    follow, start_s = request.shot.follow, request.shot.start_s
    place_m, length_m = as_number(follow), float(params.road.length_m)  # nan: it is a vehicle
    seconds = int(params.episode_decisions) * env.config.decision_s
    if place_m < 0.0 or place_m > length_m:
        raise InputError(f"--follow {follow}: allowed 0 to {length_m:g} m")
    if start_s is not None and start_s > seconds:
        raise InputError(f"--start {start_s:g}: allowed 0 to {seconds:g} s")


def _write(request: Request, recordings: Sequence[Recording]) -> None:
    out, shot = request.out, request.shot
    if out.suffix == ".html":
        write_player(out, recordings, follow=shot.follow, start_s=shot.start_s or 0.0)
        return
    from medjax.render.video import write_png, write_video

    write = write_png if out.suffix == ".png" else write_video
    write(out, recordings[0], shot)


if __name__ == "__main__":
    sys.exit(main())
