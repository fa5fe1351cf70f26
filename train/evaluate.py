"""The command that evaluates: `python -m train.evaluate --run-dir DIR --episodes 1000 --json FILE`.

The same episodes are played with the trained policy, which has the name of its algorithm ("ppo"), with its initial
policy ("start"), and with every policy of medjax.policies. Learned policies take their most probable action, and once
more sample ("ppo_sampled"). Exit code 2 on bad input. From Python:
`train.api.evaluate`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from medjax.commandline import (
    OneLineParser,
    add_set_option,
    as_path,
    cannot_write,
    command,
    fail,
    leave,
    parse_overrides,
)
from medjax.errors import InputError
from medjax.files import check_output, write_json
from medjax.policies.given import ALLOWED
from medjax.world.catalogue import PRESETS
from train.evaluation.tables import is_papers
from train.runs.run_directory import RunDir, check_matplotlib
from train.runs.trained_run import say_unneeded, to_play, trained_run_parser, whole_numbers


def build_parser() -> OneLineParser:
    """The parser of `python -m train.evaluate`."""
    parser = trained_run_parser(
        "train.evaluate",
        "Plays the same episodes with a trained policy and with every one that is not learned.",
        required=False,
        epilog=PRESETS,
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the result to this file, replacing it"
    )
    parser.add_argument(
        "--plot", metavar="FILE.png", help="draw the means of Figure 8 to this file, replacing it"
    )
    parser.add_argument(
        "--batch", default="128", metavar="N", help="episodes played together (default: 128)"
    )
    names = f"policies of the run; {ALLOWED}"
    parser.add_argument(
        "--policies",
        metavar="A,B",
        help=f"play only these, with or without a run: {names} (default: those of the run and every rule)",
    )
    parser.add_argument("--baseline", metavar="NAME", help="the policy to compare all others with")
    parser.add_argument("--force", action="store_true", help="start even if memory is short")
    parser.add_argument("--scenario", metavar="NAME", help="preset (default: the one trained on)")
    add_set_option(
        parser, "set a number of the environment, instead of that of the training; repeatable"
    )
    return parser


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Evaluates as the command line `argv` says (None: that of the process). Returns the exit code."""
    given = build_parser().parse_args(argv)
    try:
        numbers = whole_numbers(given)
        target, picture = _target("--json", given.json), _target("--plot", given.plot)
        if target is not None and target == picture:
            raise InputError(f"--json and --plot are both {target}, allowed: a file each")
        changes = parse_overrides(given.overrides)
        if given.run_dir is None and given.policies is None:
            raise InputError("neither --run-dir nor --policies, allowed: at least one of them")
        if given.run_dir is None and given.stochastic:
            raise InputError("--stochastic without --run-dir, allowed: with it")
        config = None
        if given.run_dir is not None:
            run_dir = RunDir(as_path("--run-dir", given.run_dir))
            config = to_play(run_dir.load_config(), given.scenario, changes)
        # JAX takes seconds to import; bad options are refused before.
        from train.runs import policies as run_policies

        found: dict[str, Any] = {}
        names = None if given.policies is None else given.policies.split(",")
        everyone = [*(names or ()), *([] if given.baseline is None else [given.baseline])]
        if config is None:
            env, params, config = run_policies.make_world(everyone, given.scenario, changes)
        else:
            run_policies.check_names(config, everyone)
            env, params, found = run_policies.load_policies(run_dir.path, config)
        policies = run_policies.chosen(env, found, names, given.baseline)
        run_policies.check_episodes(numbers["episodes"], len(policies), given.force)
    except InputError as error:
        return fail("python -m train.evaluate", error)
    say_unneeded("train.evaluate", given)
    from medjax.episodes.scores import evaluate_policies
    from medjax.numerics.compilation import enable_compilation_cache
    from train.evaluation.comparison import Comparison
    from train.evaluation.summary import learned_names, summarize

    enable_compilation_cache()
    print(f"evaluating {len(policies)} policies on {numbers['episodes']} episodes each", flush=True)
    scores = evaluate_policies(env, params, policies, **numbers)
    learned = learned_names(name for name in found if name in policies)
    world = config.scenario, learned, numbers["seed"], config.changes
    played = Comparison(summarize(scores, *world, given.baseline), scores, learned)
    # The numbers are saved before a table is made of them, and shown even if they could not be saved.
    unwritten = None if target is None else _unwritten(write_json, target, played.result)
    print(played)
    if picture is not None and unwritten is None:
        from train.reporting.figures import plot_comparison

        is_theirs = is_papers(played.result)
        unwritten = _unwritten(plot_comparison, picture, scores, numbers["seed"], is_theirs)
    return 0 if unwritten is None else cannot_write("python -m train.evaluate", *unwritten)


def _unwritten(write: Callable[..., None], path: Path, *what: Any) -> tuple[Path, OSError] | None:
    """Writes a file; returns it with the error if that fails."""
    try:
        write(path, *what)
    except OSError as error:
        return path, error
    return None


def _target(option: str, text: str | None) -> Path | None:
    """The file to write to, checked before the work rather than after it."""
    if text is None:
        return None
    path = as_path(option, text)
    if option == "--plot":
        if path.suffix != ".png":
            raise InputError(f"{option} {path}: allowed a file that ends in .png")
        check_matplotlib()
    check_output(option, path)
    return path


if __name__ == "__main__":
    leave(main())
