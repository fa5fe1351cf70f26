"""Command that writes trajectories: `python -m medjax.trajectories --policy NAME --scenario NAME --out FILE`.

Plays one episode in pieces and writes a row per vehicle and physics tick, as Parquet or CSV
(`medjax.episodes.table.vehicle_table` lists the columns), or as SUMO's floating-car data. Exit code 2 on bad input.
"""

import sys
import time
from collections.abc import Iterator, Sequence

from medjax.commandline import OneLineParser, as_path, cannot_write, command, fail, leave
from medjax.episodes.files import check_target, write_trajectories
from medjax.episodes.options import add_episode_options, requested_episode
from medjax.episodes.recording import Recording
from medjax.errors import InputError
from medjax.world.catalogue import PRESETS, KeepsLines
from medjax.wrappers import prepare_cpu

PROG = "python -m medjax.trajectories"
SECONDS_BETWEEN_LINES = 10.0


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Records and writes an episode; returns the exit code."""
    parser = OneLineParser(
        prog=PROG,
        description="Plays an episode and writes one row per vehicle and physics tick.",
        epilog=f"{PRESETS}\n\nExample: {PROG} --policy paced --set cooldown_s=30 --out paced.parquet",
        formatter_class=KeepsLines,
    )
    out_text = "file to write, ending in .parquet, .csv or .fcd.xml (SUMO)"
    parser.add_argument("--out", required=True, metavar="FILE", help=out_text)
    add_episode_options(parser.add_argument_group("episode"))
    given = parser.parse_args(argv)
    prepare_cpu()
    try:
        target = as_path("--out", given.out)
        check_target(target)
        played = requested_episode(given)
        env, params, chosen = played.build()
    except (InputError, ImportError) as error:
        parser.error(str(error))
    vehicles, told_at = 0, time.monotonic()

    def pieces() -> Iterator[Recording]:
        """Yields the pieces as they are played, and prints progress now and then."""
        nonlocal vehicles, told_at
        for piece in played.record_pieces(env, params, chosen):
            yield piece
            vehicles = int(piece.latest().max()) + 1
            if time.monotonic() - told_at > SECONDS_BETWEEN_LINES:
                told_at = time.monotonic()
                there = f"{piece.time_s[-1]:.0f} s of the episode, {vehicles} vehicles"
                print(f"{PROG}: {there}", file=sys.stderr)

    try:
        rows = write_trajectories(pieces(), target)
    except OSError as error:
        return cannot_write(PROG, target, error)
    except InputError as error:  # a policy of the user's own is only known once it plays
        return fail(PROG, error)
    print(f"{rows} rows, {vehicles} vehicles: {target}")
    return 0


if __name__ == "__main__":
    leave(main())
