"""`python -m train.export --run-dir DIR` writes a trained policy as a file for `medjax.policies.saved.load_policy`."""

from collections.abc import Sequence

from medjax.commandline import OneLineParser, as_path, cannot_write, command, fail, leave
from medjax.errors import InputError
from medjax.files import check_output
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Exports as the command line `argv` says (None: that of the process). Returns the exit code."""
    parser = OneLineParser(
        prog="python -m train.export",
        description="Writes the trained policy of a run as one file, for medjax.policies.saved.load_policy.",
    )
    parser.add_argument(
        "--run-dir", required=True, metavar="DIR", help="directory that train.ppo wrote"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="file to write (default: policy.zip in DIR), replaced"
    )
    given = parser.parse_args(argv)
    try:
        run_dir = RunDir(as_path("--run-dir", given.run_dir))
        target = run_dir.policy if given.out is None else as_path("--out", given.out)
        config = to_play(run_dir.load_config())
        check_output("--out", target)
        # JAX takes seconds to import; bad options are refused before.
        from train.runs.policies import export_policy, load_weights

        card = run_dir.card()
        env, params, weights = load_weights(run_dir.path, config)
    except InputError as error:
        return fail("python -m train.export", error)
    try:
        export_policy(target, env, params, config, weights, card)
    except OSError as error:
        return cannot_write("python -m train.export", target, error)
    print(target)
    return 0


if __name__ == "__main__":
    leave(main())
