"""`python -m benchmarks.soak`: plays random worlds at random and checks every invariant after every tick.

Each case is one compiled program, with sizes from `random_worlds`. It plays many environments side by side, each with
its own numbers. Half of the environments play random allowed actions, the other half any actions. In half of either
kind, MEDs also get random orders: how to move, whether to accept EVs and when to leave, as agents do
(`medjax.make_agents`). Vehicle updates count only vehicles on the road. For each violation, the soak test prints the
command that replays the episode up to the violation and explains it.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Iterator
from typing import Any, NoReturn

import jax
import jax.numpy as jnp

from benchmarks.command import a_number, benchmark_parser, machine, natural, positive, run_command
from benchmarks.verification.cases import (
    NUM_ENVS,
    Case,
    Violation,
    commanded,
    environment_keys,
    random_action,
    run_case,
    violations_of,
)
from benchmarks.verification.evidence import explain
from benchmarks.verification.invariants import INVARIANTS
from benchmarks.verification.random_worlds import as_settings, world_of
from medjax.commandline import signal_of
from medjax.env.charging_env import ChargingEnv
from medjax.errors import InputError

CASES = 16  # cases that share the updates
MOST_SHOWN = 5  # violations shown per episode


def show(case: Case, environment: int, episode: int) -> Iterator[str]:
    """Replays an episode up to its first violation in one environment, with the same program, and explains it."""
    world = world_of(case.params, environment)
    yield f"case {case.number} of seed {case.seed}: {case}"
    played = case.play(episode)
    mine = [v for v in violations_of(case, episode, played) if v.environment == environment]
    for violation in mine:
        yield str(violation).split("\n")[0]
        decision = max(violation.decision, 0)
        state = jax.tree.map(lambda leaf: leaf[environment], case.play(episode, decision).state)
        env = ChargingEnv(case.config).with_probe(lambda state: state)
        _, key = environment_keys(case.key(episode), environment)
        act_key, step_key = jax.random.split(jax.random.fold_in(key, decision))
        state = jax.jit(commanded, static_argnums=3)(
            act_key, environment, state, case.config, world
        )
        mask = env.action_mask(state, world)
        action = random_action(act_key, mask, jnp.asarray(environment % 2 == 0))
        yield f"action {int(action)} of 0 to {case.config.num_ramps}"
        yield from explain(env, world, step_key, state, action)
    yield "the world, as medjax.make and --set take it:"
    yield from (f"  --set '{setting}'" for setting in as_settings(case.config, world))
    if not mine:
        yield f"no violation in environment {environment}, episode {episode}"


def _pass(line: str) -> None:
    """Prints progress to stderr; the next line overwrites it."""
    print(line, end="\r", file=sys.stderr, flush=True)


def play(case: Case, share: float, rows: list[dict[str, Any]]) -> Iterator[list[Violation]]:
    """Plays a case up to `share` vehicle updates. Yields each episode's violations, and counts them in a new row."""
    start = time.perf_counter()
    row = {"case": case.number, **dataclasses.asdict(case.config)}
    row |= {"compile_s": case.compile_s, "updates": 0, "violations": 0}
    rows.append(row)
    for moved, found in run_case(case, share):
        row["updates"] += moved
        row["violations"] += sum(sum(v.counts.values()) for v in found)
        row["play_s"] = time.perf_counter() - start
        for violation in found[:MOST_SHOWN]:
            print(violation, flush=True)
        if len(found) > MOST_SHOWN:
            print(f"  ... and in {len(found) - MOST_SHOWN} more environments")
        total = sum(each["updates"] for each in rows)
        _pass(f"case {case.number}: {row['updates'] / share:.0%}, in all {total:,} updates")
        yield found
    print(
        f"case {case.number:2d}: {case}: {row['updates']:,} updates, {row['violations']} violations, "
        f"{case.compile_s:.0f} + {row['play_s']:.0f} s",
        flush=True,
    )


def show_again(options: argparse.Namespace) -> NoReturn:
    """Prints one environment's first violation, if any, and exits. Raises InputError for invalid options."""
    if options.case is None or options.environment is None:
        raise InputError("--case and --environment: allowed both or none")
    if options.environment >= options.num_envs:
        allowed = f"allowed 0 to {options.num_envs - 1}"
        raise InputError(f"--environment {options.environment}: {allowed}")
    case = Case(options.seed, options.case, options.num_envs)
    lines = list(show(case, options.environment, options.episode))
    print(*lines, sep="\n")
    sys.exit(any("VIOLATED" in line for line in lines))


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Plays all cases and prints the totals."""
    if options.case is not None or options.environment is not None:
        show_again(options)
    start = time.perf_counter()
    rows: list[dict[str, Any]] = []
    found: list[Violation] = []
    stopped_by: int | None = None  # the signal that ended it early
    try:
        for number in range(options.cases):
            _pass(f"case {number}: compiling ...")
            case = Case(options.seed, number, options.num_envs)
            for violations in play(case, options.updates / options.cases, rows):
                found += violations
    except KeyboardInterrupt as error:
        print("\nstopped")
        stopped_by = signal_of(error)
    report = {
        "seed": options.seed,
        "updates": sum(row["updates"] for row in rows),
        "wall_s": time.perf_counter() - start,
        "num_envs": options.num_envs,
        "violations": {name: sum(v.counts.get(name, 0) for v in found) for name in INVARIANTS},
        "commands": [violation.command() for violation in found],
        "cases": rows,
        "stopped_by": stopped_by,
        **machine(),
    }
    print(f"\n{report['updates']:,} vehicle updates in {report['wall_s']:.0f} s; violations:")
    for name, what in INVARIANTS.items():
        print(f"  {name:<9}{report['violations'][name]:>8}   {what}")
    return report


def main(arguments: list[str] | None = None) -> None:
    """The command; its exit code is 1 if anything was violated, else 128 and the signal if one stopped it early."""
    parser = benchmark_parser("soak", __doc__)
    above_0 = a_number("a number above 0", lambda value: value > 0.0)
    parser.add_argument("--updates", type=above_0, default=1e9, help="total vehicle updates")
    parser.add_argument("--seed", type=natural, default=0, help="seed of the random worlds")
    parser.add_argument("--num-envs", type=positive, default=NUM_ENVS, help="environments per case")
    cases = "cases that share the updates"
    parser.add_argument("--cases", type=positive, default=CASES, help=cases)
    again = parser.add_argument_group("to replay one environment's first violation")
    again.add_argument("--case", type=natural, metavar="C", help="number of the case")
    environment = "index of the environment in the case"
    again.add_argument("--environment", type=natural, metavar="E", help=environment)
    again.add_argument("--episode", type=natural, default=0, help="episode of the environment")
    report = run_command(parser, measure, arguments)
    early = report["stopped_by"]
    sys.exit(1 if report["commands"] else 0 if early is None else 128 + early)
