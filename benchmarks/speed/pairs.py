"""`python -m benchmarks.pairs TREE TREE`: how fast the decisions of several checkouts are, as shares of the first's.

Each tree runs in a process of its own. The processes take turns within a second or so, and the processor time of each
call is compared with that of the first tree in the same round. So a change of the machine's speed cancels. Other work
does not quite: it takes from the cores' caches, which costs one tree more than another.
"""

import argparse
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.command import (
    add_scenario,
    benchmark_parser,
    positive,
    run_command,
    say,
    whole_number,
)
from medjax.errors import InputError

# Runs in the tree's own folder, so it uses only what trees have had for long.
WORKER = """
import sys, time
from medjax.numerics.devices import prepare_cpu
prepare_cpu()
from benchmarks.speed.workload import Workload
work = Workload(int(sys.argv[1]), steps=10, scenario=sys.argv[2])
work.play()
print(work.compile_s, flush=True)
for _ in sys.stdin:
    start = time.process_time()
    wall, active = work.play()
    print(wall, time.process_time() - start, active, flush=True)
"""


class Tree:
    """A checkout whose process waits for its turns."""

    def __init__(self, path: Path, num_envs: int, scenario: str) -> None:
        self.path = path
        command = [sys.executable, "-c", WORKER, str(num_envs), scenario]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, cwd=path, stdin=pipe, stdout=pipe, text=True)
        self.compile_s = self._read()[0]
        say(f"{path}: compiled in {self.compile_s:.1f} s")

    def _read(self) -> list[float]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise InputError(f"{self.path}: its process ended, allowed: a checkout that runs")
        return [float(word) for word in line.split()]

    def play(self) -> tuple[float, float]:
        """Vehicle updates of one turn per second of wall-clock time and of processor time."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        wall, busy, active = self._read()
        return active / wall, active / busy

    def end(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.wait()


def summarize(rounds: list[list[tuple[float, float]]], names: list[str]) -> list[dict[str, Any]]:
    """A row per tree: median speeds, and the quartiles of its speed as a share of the first tree's in each round.

    Args:
      rounds: for each round, wall-clock and processor speeds of every tree.
    """
    rows = []
    for index, name in enumerate(names):
        row: dict[str, Any] = {"tree": name}
        for which, clock in enumerate(("wall", "processor")):
            row[f"updates_per_{clock}_s"] = statistics.median(turn[index][which] for turn in rounds)
            shares = [turn[index][which] / turn[0][which] for turn in rounds]
            row[f"{clock}_share"] = statistics.quantiles(shares, n=4, method="inclusive")
        rows.append(row)
    return rows


def compare(options: argparse.Namespace) -> dict[str, Any]:
    """Times the trees by turns and prints the table."""
    trees: list[Tree] = []
    for path in options.trees:
        if not (path / "benchmarks" / "speed" / "workload.py").is_file():
            raise InputError(f"{path}: no checkout of medjax, allowed: its folder")
    try:
        trees += [Tree(path, options.num_envs, options.scenario) for path in options.trees]
        rounds = []
        for number in range(options.rounds):
            # Every other round goes backwards, so that no tree always follows the same one.
            turns = trees if number % 2 else trees[::-1]
            played = {id(tree): tree.play() for tree in turns}
            rounds.append([played[id(tree)] for tree in trees])
    finally:
        for tree in trees:
            tree.end()
    rows = summarize(rounds, [str(path) for path in options.trees])
    print(
        f"{options.num_envs} environments of {options.scenario}, {options.rounds} rounds; "
        "shares of the first tree's speed"
    )
    for row, tree in zip(rows, trees, strict=True):
        row["compile_s"] = tree.compile_s
        low, middle, high = row["processor_share"]
        wall = row["wall_share"][1]
        print(
            f"{row['tree']:<24} processor time {middle:.3f} [{low:.3f}, {high:.3f}], wall-clock {wall:.3f}, "
            f"{row['updates_per_wall_s'] / 1e6:.2f} M updates/s, compiled in {tree.compile_s:.1f} s"
        )
    asked = {name: getattr(options, name) for name in ("scenario", "num_envs", "rounds")}
    return {**asked, "trees": rows}


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("pairs", __doc__)
    parser.add_argument("trees", type=Path, nargs="+", metavar="TREE", help="folder of a checkout")
    text = "environments side by side (default: 512)"
    parser.add_argument("--num-envs", type=positive, default=512, metavar="N", help=text)
    text = "turns of each tree, at least 2 (default: 24)"
    parser.add_argument("--rounds", type=whole_number(2), default=24, metavar="N", help=text)
    add_scenario(parser)
    run_command(parser, compare, arguments)
