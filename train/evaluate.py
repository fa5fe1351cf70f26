"""The command that evaluates: `python -m train.evaluate --run-dir DIR --episodes 1000 --json FILE`.

The trained policy ("ppo") and every policy of medjax.policies play the same episodes. Exit code 2 on bad input.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train.cli import OneLineParser, add_set_option, fail, make_environment, parse_overrides
from train.config import SettingError, TrainConfig
from train.rundir import RunDir, check_writable, write_json

LIMITS = {"episodes": (2, 10**7), "batch": (1, 10**6), "seed": (0, 2**32 - 1)}


def build_parser() -> OneLineParser:
    """The parser of `python -m train.evaluate`."""
    parser = OneLineParser(
        prog="python -m train.evaluate",
        description="Plays the same episodes with a trained policy and with every one that is not learned.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--run-dir", required=True, metavar="DIR", help="directory that train.ppo wrote"
    )
    parser.add_argument(
        "--episodes", default="200", metavar="N", help="whole episodes per policy (default: 200)"
    )
    parser.add_argument("--json", metavar="FILE", help="write the result there, over what it holds")
    parser.add_argument("--seed", default="0", metavar="N", help="which episodes (default: 0)")
    parser.add_argument(
        "--batch", default="128", metavar="N", help="episodes played together (default: 128)"
    )
    parser.add_argument("--scenario", metavar="NAME", help="preset (default: the one trained on)")
    add_set_option(
        parser, "set a number of the environment, over those of the training; repeatable"
    )
    parser.add_argument(
        "--stochastic",
        action="store_true",
        help="sample the trained policy's actions; else the most probable",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluates as the command line says.

    Args:
        argv: arguments; None takes those of the process.

    Returns:
        The exit code.
    """
    given = build_parser().parse_args(argv)
    try:
        numbers = {name: _number(name, getattr(given, name)) for name in LIMITS}
        target = _target(given.json)
        config = _config(given)
        # JAX and Orbax take seconds to import; bad options need not wait for them.
        from medjax.wrappers import prepare_cpu

        prepare_cpu()
        env, params = make_environment(config)
        from train.checkpoint import Checkpoints
        from train.closing import all_policies
        from train.evaluation import evaluate_policies, summarize
        from train.host import enable_compilation_cache
        from train.learner import make_train
        from train.report import format_table
        from train.session import shapes_of

        reader = Checkpoints(Path(given.run_dir))
        shapes = shapes_of(make_train(env, params, config), params, config)
        weights = reader.restore_weights(shapes)
        reader.close()
    except SettingError as error:
        return fail("train.evaluate", error)
    enable_compilation_cache()
    policies = all_policies(env, config, weights, given.stochastic)
    try:
        scores = evaluate_policies(env, params, policies, **numbers)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    result = summarize(scores, config.scenario, numbers["seed"])
    if target is not None:
        write_json(target, result)
    print(format_table(result))
    return 0


def _config(given: Any) -> TrainConfig:
    """Settings of the run, with the environment that is asked for."""
    config = RunDir(Path(given.run_dir)).load_config()
    changes = parse_overrides(getattr(given, "overrides", []))
    same = given.scenario in (None, config.scenario)
    scenario = config.scenario if same else given.scenario
    # What was set for one preset may mean nothing in another.
    overrides = {**config.overrides, **changes} if same else changes
    # This machine need not have the devices that the run had.
    return dataclasses.replace(config, scenario=scenario, overrides=overrides, num_devices=0)


def _number(name: str, text: str) -> int:
    low, high = LIMITS[name]
    if not text.strip().isdecimal() or not low <= int(text) <= high:
        raise SettingError(f"{name} is {text}, allowed: a whole number from {low} to {high}")
    return int(text)


def _target(text: str | None) -> Path | None:
    """File to write the result to, refused now rather than after the work."""
    if text is None:
        return None
    path = Path(text)
    try:
        if path.is_dir():
            raise SettingError(f"json is {path}, which is a directory, allowed: a file")
        check_writable(path.parent)
    except OSError as error:
        raise SettingError(
            f"cannot write {path}: {error.strerror}, allowed: a file in a writable directory"
        ) from None
    return path


if __name__ == "__main__":
    sys.exit(main())
