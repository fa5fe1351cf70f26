"""The command that makes the paper's tables and figures: `python -m train.report --run-dir DIR`.

The trained policy, which has the name of its algorithm ("ppo"), and every policy of medjax.policies play the episodes
of `train.evaluate`. DIR/report receives PNGs and one self-contained HTML page, which replace those of an earlier
report. Exit code 2 on bad input.
"""

from collections.abc import Sequence
from pathlib import Path

from medjax.commandline import as_path, cannot_write, command, fail, leave
from medjax.errors import InputError
from medjax.files import check_writable
from train.runs.run_directory import RunDir, check_matplotlib
from train.runs.trained_run import say_unneeded, to_play, trained_run_parser, whole_numbers


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Makes the report as the command line `argv` says (None: that of the process). Returns the exit code."""
    parser = trained_run_parser(
        "train.report",
        "Makes the paper's tables and figures of a trained run in DIR/report, as PNGs and one HTML page.",
    )
    given = parser.parse_args(argv)
    try:
        numbers = whole_numbers(given)
        run_dir = RunDir(as_path("--run-dir", given.run_dir))
        config = to_play(run_dir.load_config())
        _check_target(run_dir.report)
        # JAX takes seconds to import; bad options are refused before.
        from train.runs.logs import read_rows
        from train.runs.policies import check_episodes, load_policies

        env, params, policies = load_policies(run_dir.path, config)
        if not env.config.num_ramps:
            raise InputError("num_ramps is 0, allowed: a run with ramps to send MEDs from")
        check_episodes(numbers["episodes"], len(policies))
        read_rows(run_dir.metrics)  # refuses a damaged file
    except InputError as error:
        return fail("python -m train.report", error)
    say_unneeded("train.report", given)
    from medjax.numerics.compilation import enable_compilation_cache
    from train.reporting.report import draw, play, write

    enable_compilation_cache()
    try:
        played = play(env, params, config, policies, **numbers)
        print("drawing", flush=True)
        draw(run_dir, config, played)
        write(run_dir, config, played)
    except OSError as error:
        return cannot_write("python -m train.report", run_dir.report, error)
    print(f"Report: {run_dir.report / 'report.html'}")
    return 0


def _check_target(path: Path) -> None:
    """Refuses before the work what would fail after it: an unwritable target, or no matplotlib."""
    check_matplotlib()
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is not a directory, allowed: a directory, or nothing")
    try:
        check_writable(path if path.exists() else path.parent)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror}, allowed: a writable directory"
        ) from None


if __name__ == "__main__":
    leave(main())
