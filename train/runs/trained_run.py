"""Shared parts of the commands on a trained run: their options, and the settings that they play it with."""

import argparse
import dataclasses
import sys
from collections.abc import Mapping

from medjax.commandline import OneLineParser, whole_number
from medjax.world.catalogue import KeepsLines
from train.option import Override
from train.settings import TrainConfig

LIMITS = {"episodes": (2, 10**7), "batch": (1, 10**6), "seed": (0, 2**32 - 1)}


def trained_run_parser(
    prog: str, description: str, required: bool = True, epilog: str = ""
) -> OneLineParser:
    """The parser of a command that plays whole episodes with the policy of a run; `required`: it needs `--run-dir`."""
    parser = OneLineParser(
        prog=f"python -m {prog}",
        description=description,
        epilog=epilog,
        formatter_class=KeepsLines,
    )
    text = "directory that train.ppo wrote"
    parser.add_argument("--run-dir", required=required, metavar="DIR", help=text)
    text = "whole episodes per policy (default: 200)"
    parser.add_argument("--episodes", default="200", metavar="N", help=text)
    text = "seed of the episodes (default: 0)"
    parser.add_argument("--seed", default="0", metavar="N", help=text)
    parser.add_argument("--stochastic", action="store_true", help=argparse.SUPPRESS)
    return parser


def say_unneeded(prog: str, given: argparse.Namespace) -> None:
    """Prints a line to stderr if `--stochastic` was given, which has lost its use and goes with the next version."""
    if given.stochastic:
        said = "--stochastic is not needed, policies that sample have rows of their own"
        print(f"python -m {prog}: {said}", file=sys.stderr)


def whole_numbers(given: argparse.Namespace) -> dict[str, int]:
    """The command's options that are in `LIMITS`, checked."""
    return {
        name: whole_number(f"--{name}", getattr(given, name), *limits)
        for name, limits in LIMITS.items()
        if name in given
    }


def to_play(
    config: TrainConfig, scenario: str | None = None, changes: Mapping[str, Override] | None = None
) -> TrainConfig:
    """Settings for playing a run on this machine, in the requested environment.

    Args:
        config: settings of the run.
        scenario: preset; None takes that of the run.
        changes: numbers of the environment. They override those of the run, which are kept only for the same preset:
            in another they may be meaningless.
    """
    scenario = config.scenario if scenario is None else scenario
    kept = config.overrides if scenario == config.scenario else {}
    overrides = {**kept, **(changes or {})}
    # This machine may lack the devices that the run had.
    return dataclasses.replace(config, scenario=scenario, overrides=overrides, num_devices=0)
