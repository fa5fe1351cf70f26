"""`python -m benchmarks.ablation STUDY`: what a number of the world, or a weight of the reward, does.

misalignment, humans, cooldown, fleet and power play rules, and a trained run, in worlds that differ in this one number;
weights trains a dispatcher for each of several rewards. All worlds of a study run side by side in one compiled
program and on the same episodes, so that what differs is due to the number that was changed. The options of a study:
`python -m benchmarks.ablation STUDY --help`.
"""

import argparse
from functools import partial

from benchmarks.command import add_plot, episodes_parser, run_command
from benchmarks.studies.ablation import sweeps, weights
from medjax.commandline import OneLineParser, add_set_option
from medjax.numerics.compilation import enable_compilation_cache

WEIGHTS = "weights"


def main(arguments: list[str] | None = None) -> None:
    top = OneLineParser(
        prog="python -m benchmarks.ablation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("study", choices=[WEIGHTS, *sweeps.SWEEPS])
    top.add_argument(
        "options", nargs=argparse.REMAINDER, help="options of the study, see STUDY --help"
    )
    chosen = top.parse_args(arguments)
    study, trains = chosen.study, chosen.study == WEIGHTS
    note = weights.NOTE if trains else sweeps.SWEEPS[study].note
    parser = episodes_parser(f"ablation {study}", note, episodes=128, seed=0)
    parser.set_defaults(scenario=None)  # that of the run, else the default of train.ppo
    add_set_option(parser, "set another parameter of the environment, as in train.ppo; repeatable")
    add_plot(parser, "the figure")
    shown = "sample the trained policy's actions instead of taking the most probable"
    parser.add_argument("--stochastic", action="store_true", help=shown)
    if trains:
        weights.add_options(parser)
    else:
        sweeps.add_options(parser, study)
    run = weights.run if trains else partial(sweeps.run, study)
    enable_compilation_cache()
    run_command(parser, run, chosen.options, weights.plot if trains else sweeps.plot)


if __name__ == "__main__":
    main()
