"""`python -m benchmarks.soak`: random play in random worlds, where every invariant is checked after every tick.

Each case is one compiled program: sizes drawn by `benchmarks.worlds`, and environments side by side, each with numbers
of its own, that play under random actions: allowed ones in one half of them, any in the other. Vehicle updates are
counted as vehicles really on the road. A violation prints the one command that plays up to it again and shows it.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

import medjax
from benchmarks.arguments import benchmark_parser, positive, whole_number
from benchmarks.evidence import explain
from benchmarks.invariants import (
    INVARIANTS,
    Counts,
    check_decision,
    check_lanes,
    check_state,
    count,
    lengths_of,
)
from benchmarks.worlds import (
    as_settings,
    draw_config,
    draw_params,
    random_units,
    validated,
    world_of,
)
from medjax.config import EnvConfig, EnvParams
from medjax.env import ChargingEnv
from medjax.state import EnvState
from medjax.wrappers import environment_mesh, on_devices, prepare_cpu
from train.cli import OneLineParser

NUM_ENVS = 256
CASES = 16  # that the updates are shared among
EPISODE_S = 150.0
MOST_SHOWN = 5  # violations of an episode
NEVER = 2**30


class Played(struct.PyTreeNode):
    """An episode in each of B environments."""

    state: EnvState  # (B, ...) after the last decision
    updates: jax.Array  # (B,) int32, vehicles on the road, summed over ticks
    violations: jax.Array  # (B, len(INVARIANTS)) int32
    first: jax.Array  # (B,) int32, decision of the first violation; -1: at reset; NEVER: none


def in_order(counts: Counts) -> jax.Array:
    """Counts in the order of INVARIANTS, (K,) int32."""
    return jnp.stack([counts[name] for name in INVARIANTS])


def check_start(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Violations in a state at reset, (K,) int32."""
    vehicles = state.vehicles
    counts = count(
        check_lanes(vehicles, vehicles, lengths_of(state, config, params)),
        check_state(state, config, params),
    )
    return in_order(counts)


def random_action(key: jax.Array, mask: jax.Array, wild: jax.Array) -> jax.Array:
    """Any action, out of range and masked ones among them, or one that is allowed, () int32."""
    any_key, allowed_key = jax.random.split(key)
    anything = jax.random.randint(any_key, (), -1, mask.shape[0] + 1)
    allowed = jax.random.randint(allowed_key, (), 0, mask.shape[0])
    return jnp.where(wild, anything, jnp.where(mask[allowed], allowed, 0))


def environment_keys(key: jax.Array, index: Any) -> jax.Array:
    """Keys of an environment's reset and of its decisions, in an episode with this key."""
    return jax.random.split(jax.random.fold_in(key, index))


def episode_program(config: EnvConfig, num_devices: int = 0) -> Any:
    """`(params, key, decisions)` to `Played`: the first decisions of the key's episode in each environment, checked.

    Args of the program:
      params: NumPy leaves (B, ...), but the coils' table, which all share.
      key: of the episode.
      decisions: () int32, traced: one program plays to any decision, bit for bit the same way.
    """
    env = ChargingEnv(config, probe=lambda state: state)

    def play(index: jax.Array, params: EnvParams, key: jax.Array, decisions: jax.Array) -> Played:
        """One environment."""
        reset_key, key = environment_keys(key, index)
        _, state = env.reset(reset_key, params)
        found = check_start(state, config, params)
        first = jnp.where(found.any(), -1, NEVER).astype(jnp.int32)

        def decide(decision: jax.Array, played: Played) -> Played:
            act_key, step_key = jax.random.split(jax.random.fold_in(key, decision))
            before = played.state
            action = random_action(act_key, env.action_mask(before, params), index % 2 == 0)
            obs, state, reward, _, _, info = env.step_env(step_key, before, action, params)
            counts = check_decision(before, state, obs, reward, info, config, params)
            found = in_order(counts)
            return Played(
                state=state,
                updates=played.updates + info["tally"].vehicle_ticks.astype(jnp.int32),
                violations=played.violations + found,
                first=jnp.minimum(played.first, jnp.where(found.any(), decision, NEVER)),
            )

        start = Played(state, jnp.zeros((), jnp.int32), found, first)
        return jax.lax.fori_loop(0, decisions, decide, start)

    def play_rows(rows: tuple[jax.Array, EnvParams], same: tuple[Any, ...]) -> Played:
        def one(index: jax.Array, params: EnvParams) -> Played:
            link = params.link.replace(inductance=same[0])
            return play(index, params.replace(link=link), *same[1:])

        return jax.vmap(one)(*rows)

    @jax.jit
    def program(params: EnvParams, key: jax.Array, decisions: jax.Array) -> Played:
        table, index = params.link.inductance, jnp.arange(jnp.shape(params.battery_scale)[0])
        rows = index, params.replace(link=params.link.replace(inductance=None))
        mesh = environment_mesh(index.shape[0], num_devices)
        return on_devices(mesh, play_rows)(rows, (table, key, decisions))

    return program


class Case:
    """Case number `number` of a seed: sizes, the numbers of each environment, and the compiled program.

    Args:
      seed, number: which case.
      num_envs: environments side by side; others play otherwise.
      config: sizes instead of those drawn.
    """

    def __init__(
        self, seed: int, number: int, num_envs: int = NUM_ENVS, config: EnvConfig | None = None
    ) -> None:
        self.seed, self.number, self.num_envs = seed, number, num_envs
        self.config = config or draw_config(seed, number)
        _, paper = medjax.make("paper")
        rng = np.random.default_rng([seed, number])
        table = jax.device_get(paper.link.inductance)
        drawn = draw_params(random_units(rng, num_envs), self.config, table)
        self.params = validated(self.config, drawn)
        self.decisions = math.ceil(EPISODE_S / self.config.decision_s)
        start = time.perf_counter()
        args = self.params, self.key(0), np.int32(0)
        self.program = episode_program(self.config).lower(*args).compile()
        self.compile_s = time.perf_counter() - start

    def key(self, episode: int) -> jax.Array:
        """Of an episode."""
        key = jax.random.key(self.seed)
        return jax.random.fold_in(jax.random.fold_in(key, self.number), episode)

    def play(self, episode: int, decisions: int | None = None) -> Played:
        """An episode in every environment, or its first decisions, as NumPy arrays."""
        count = np.int32(self.decisions if decisions is None else decisions)
        return jax.device_get(self.program(self.params, self.key(episode), count))

    def __str__(self) -> str:
        c = self.config
        return (
            f"{c.num_lanes} lanes, {c.num_ramps} ramps, {c.tick_s:g} s x {c.ticks_per_decision}, "
            f"{c.num_meds} MEDs, {c.num_evs} EVs, {c.num_gas} gas"
        )


@dataclasses.dataclass(frozen=True)
class Violation:
    """The first violation in an environment of a case."""

    case: Case
    environment: int
    episode: int
    decision: int  # -1: at reset
    counts: dict[str, int]  # in the whole episode

    def command(self) -> str:
        """What shows it again."""
        words = ["python -m benchmarks.soak", f"--seed {self.case.seed}"]
        words += [f"--case {self.case.number}", f"--environment {self.environment}"]
        if self.episode:
            words.append(f"--episode {self.episode}")
        if self.case.num_envs != NUM_ENVS:
            words.append(f"--num-envs {self.case.num_envs}")
        return " ".join(words)

    def __str__(self) -> str:
        where = f"decision {self.decision}" if self.decision >= 0 else "the reset"
        counts = ", ".join(f"{name} {count}" for name, count in self.counts.items())
        return (
            f"VIOLATED: {counts}: seed {self.case.seed}, case {self.case.number}, environment "
            f"{self.environment}, episode {self.episode}, first in {where}\n  {self.command()}"
        )


def violations_of(case: Case, episode: int, played: Played) -> list[Violation]:
    """Of an episode, one an environment."""
    return [
        Violation(
            case,
            int(row),
            episode,
            int(played.first[row]),
            {
                name: int(count)
                for name, count in zip(INVARIANTS, played.violations[row], strict=True)
                if count
            },
        )
        for row in np.flatnonzero(played.first < NEVER)
    ]


def run_case(case: Case, updates: float) -> Iterator[tuple[int, list[Violation]]]:
    """Episodes of a case until it has moved so many vehicles: updates and violations of each."""
    done, episode = 0, 0
    while done < updates:
        played = case.play(episode)
        moved = int(played.updates.sum(dtype=np.int64))
        yield moved, violations_of(case, episode, played)
        # A case without demand and MEDs never moves anyone; others always do.
        done, episode = done + max(moved, case.num_envs), episode + 1


def show(case: Case, environment: int, episode: int) -> Iterator[str]:
    """Plays an episode up to its first violation in one environment, by the same program, and says what happened."""
    world = world_of(case.params, environment)
    yield f"case {case.number} of seed {case.seed}: {case}"
    played = case.play(episode)
    mine = [v for v in violations_of(case, episode, played) if v.environment == environment]
    for violation in mine:
        yield str(violation).split("\n")[0]
        decision = max(violation.decision, 0)
        state = jax.tree.map(lambda leaf: leaf[environment], case.play(episode, decision).state)
        env = ChargingEnv(case.config, probe=lambda state: state)
        _, key = environment_keys(case.key(episode), environment)
        act_key, step_key = jax.random.split(jax.random.fold_in(key, decision))
        mask = env.action_mask(state, world)
        action = random_action(act_key, mask, jnp.asarray(environment % 2 == 0))
        yield f"action {int(action)} of 0 to {case.config.num_ramps}"
        yield from explain(env, world, step_key, state, action)
    yield "the world, as medjax.make and --set take it:"
    yield from (f"  --set '{setting}'" for setting in as_settings(case.config, world))
    if not mine:
        yield f"no violation in environment {environment}, episode {episode}"


def positive_number(text: str) -> float:
    """A type of argument: a number above 0, such as 1e9."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: allowed a number above 0")
    return number


def build_parser() -> OneLineParser:
    """The command line."""
    parser = benchmark_parser("soak", __doc__)
    parser.add_argument(
        "--updates", type=positive_number, default=1e9, help="vehicle updates in all"
    )
    parser.add_argument("--seed", type=whole_number(least=0), default=0)
    parser.add_argument("--num-envs", type=positive, default=NUM_ENVS, help="of a case")
    parser.add_argument("--cases", type=positive, default=CASES, help="that share the updates")
    again = parser.add_argument_group("to see one environment's first violation again")
    again.add_argument("--case", type=whole_number(least=0), metavar="C")
    again.add_argument("--environment", type=whole_number(least=0), metavar="E")
    again.add_argument("--episode", type=whole_number(least=0), default=0)
    return parser


class Soak:
    """Cases one after the other, and what they came to."""

    def __init__(self, seed: int, updates: float, num_envs: int, cases: int) -> None:
        self.seed, self.updates, self.num_envs, self.cases = seed, updates, num_envs, cases
        self.rows: list[dict[str, Any]] = []
        self.moved = 0
        self.found: list[Violation] = []
        self.start = time.perf_counter()

    def run(self) -> None:
        """Prints a line a case, and every case's first violations."""
        share = self.updates / self.cases
        for number in range(self.cases):
            print(f"case {number}: compiling ...", end="\r", file=sys.stderr, flush=True)
            case = Case(self.seed, number, self.num_envs)
            self._play(case, share)

    def _play(self, case: Case, share: float) -> None:
        start = time.perf_counter()
        row = {"case": case.number, **dataclasses.asdict(case.config)}
        row |= {"compile_s": case.compile_s, "updates": 0, "violations": 0}
        self.rows.append(row)
        for moved, found in run_case(case, share):
            self.moved += moved
            self.found += found
            row["updates"] += moved
            row["violations"] += sum(sum(v.counts.values()) for v in found)
            row["play_s"] = time.perf_counter() - start
            for violation in found[:MOST_SHOWN]:
                print(violation, flush=True)
            if len(found) > MOST_SHOWN:
                print(f"  ... and in {len(found) - MOST_SHOWN} more environments")
            print(
                f"case {case.number}: {row['updates'] / share:.0%}, in all {self.moved:,} updates",
                end="\r",
                file=sys.stderr,
                flush=True,
            )
        print(
            f"case {case.number:2d}: {case}: {row['updates']:,} updates, {row['violations']} violations, "
            f"{case.compile_s:.0f} + {row['play_s']:.0f} s",
            flush=True,
        )

    def report(self) -> dict[str, Any]:
        """Totals, by invariant and by case."""
        totals = {
            name: sum(violation.counts.get(name, 0) for violation in self.found)
            for name in INVARIANTS
        }
        return {
            "seed": self.seed,
            "updates": self.moved,
            "wall_s": time.perf_counter() - self.start,
            "num_envs": self.num_envs,
            "violations": totals,
            "commands": [violation.command() for violation in self.found],
            "cases": self.rows,
            "device": jax.devices()[0].device_kind,
            "jax_version": jax.__version__,
        }


def main(arguments: list[str] | None = None) -> None:
    """Plays, prints, and ends with exit code 1 if anything was violated."""
    parser = build_parser()
    options = parser.parse_args(arguments)
    if (options.case is None) != (options.environment is None):
        parser.error("--case and --environment: allowed both or none")
    prepare_cpu()
    if options.case is not None:
        if options.environment >= options.num_envs:
            parser.error(
                f"--environment {options.environment}: allowed 0 to {options.num_envs - 1}"
            )
        case = Case(options.seed, options.case, options.num_envs)
        lines = list(show(case, options.environment, options.episode))
        print("\n".join(lines))
        sys.exit(any("VIOLATED" in line for line in lines))
    soak = Soak(options.seed, options.updates, options.num_envs, options.cases)
    try:
        soak.run()
    except KeyboardInterrupt:
        print("\nstopped")
    report = soak.report()
    print(f"\n{report['updates']:,} vehicle updates in {report['wall_s']:.0f} s; violations:")
    for name, what in INVARIANTS.items():
        print(f"  {name:<9}{report['violations'][name]:>8}   {what}")
    if options.json:
        options.json.write_text(json.dumps(report, indent=2))
    sys.exit(bool(soak.found))


if __name__ == "__main__":
    main()
