"""Shared parts of the commands on a trained run: their options, and the settings that they play it with."""

import argparse
import dataclasses
import sys
from collections.abc import Mapping
from typing import Any

from medjax.commandline import OneLineParser, whole_number
from medjax.world.catalogue import KeepsLines
from train.option import Override
from train.settings import TrainConfig

LIMITS = {"episodes": (2, 10**7), "batch": (1, 10**6), "seed": (0, 2**32 - 1)}


class _Unneeded(argparse.Action):
    """Says that the option has lost its use; it goes with the next version."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        """Prints a line to stderr."""
        said = f"{parser.prog}: --stochastic is not needed, policies that sample have rows of their own"
        print(said, file=sys.stderr)


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
    parser.add_argument("--stochastic", action=_Unneeded, nargs=0, help=argparse.SUPPRESS)
    return parser


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
