"""The command that trains: `python -m train.ppo`; `--help` lists all options.

Exit code 0: done. 1: a number was no longer finite, or the run directory could not be written; `--resume` continues
from the newest checkpoint. 2: bad input; nothing was changed. 128 + signal: interrupted (130 for Ctrl-C); the state
was saved.
"""

from collections.abc import Sequence

from medjax.commandline import command, fail, leave
from medjax.errors import InputError
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import parse_request


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Trains and evaluates as the command line `argv` says (None: that of the process). Returns the exit code."""
    request = parse_request(PPOConfig, argv)
    # JAX takes seconds to import; --help and bad options are handled before.
    from train.runs.open_session import open_session

    try:
        session = open_session(request)
    except InputError as error:
        return fail("python -m train.ppo", error)
    return session.run()


if __name__ == "__main__":
    leave(main())
