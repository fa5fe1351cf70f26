"""Compares policies on the fixed episodes of a leaderboard.

The command prints the board. `--add NAME --policy P` first plays all of its episodes with a policy and writes the new
row into the file. A row keeps the return of every episode, so that later policies are compared on the same episodes.
The file holds their seed; no policy may be trained on them. For the project's own board the command also writes the
means that the player shows (`medjax.render.story.known_evaluation`).

    python -m benchmarks.leaderboard
    python -m benchmarks.leaderboard --add mine --policy runs/mine/policy.zip --about "PPO, 1.5 M decisions"
    python -m benchmarks.leaderboard --again
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import a_path, benchmark_parser, run_command, say, write
from benchmarks.studies.base import estimate, format_estimate
from medjax.episodes.verdict import NAMES
from medjax.errors import InputError, shown
from medjax.files import check_input, check_output, write_text
from medjax.policies.given import ALLOWED, check_policy
from medjax.policies.pretrained import PRETRAINED, PRETRAINED_SAMPLED
from medjax.policies.rules import BASELINES
from medjax.render.story import KNOWN
from train.api import evaluate
from train.evaluation.statistics import bootstrap_ci95
from train.evaluation.summary import verdict_ci95
from train.evaluation.tables import format_rows, interval, short
from train.runs.versions import versions

BOARD = Path(__file__).parents[2] / "docs" / "leaderboard.json"
SHOWN = {"depleted": "depleted_share", "mean SoC": "mean_soc", "MEDs sent": "meds_dispatched"}
MEANS = sorted({*SHOWN.values(), *NAMES} - {"return_mean"})  # metrics that a row keeps
DIGITS = 3  # after the point of returns that a row keeps


def read_board(path: Path) -> dict[str, Any]:
    """Reads a board: its preset, seed, number of episodes, and rows.

    Raises:
      InputError: there is no such file, or it is not a board.
    """
    check_input("--file", path)
    try:
        board: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        lengths = {len(row["returns"]) for row in board["rows"]}
        names = {row[key] for row in board["rows"] for key in ("name", "policy", "about")}
        shown_of = [row["means"][metric] for row in board["rows"] for metric in SHOWN.values()]
        shown_of += [value for row in board["rows"] for value in row["returns"]]
        texts = {board["scenario"], *names}
        sound = all(isinstance(text, str) for text in texts) and lengths <= {board["episodes"]}
        sound = sound and isinstance(board["seed"], int) and all(map(math.isfinite, shown_of))
        sound = sound and board["episodes"] > 0
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        sound = False
    if not sound:
        raise InputError(f"--file {path}: allowed a board, such as docs/leaderboard.json")
    return board


def play(board: Mapping[str, Any], name: str, policy: str, about: str) -> dict[str, Any]:
    """Plays the board's episodes with a policy, which `medjax.policies.given.as_policy` accepts; returns its row."""
    scenario, episodes, seed = (board[key] for key in ("scenario", "episodes", "seed"))
    say(f"{name}: {episodes} episodes of {scenario} ...")
    scores = evaluate(scenario, None, {name: policy}, episodes=episodes, seed=seed).scores[name]
    return {
        "name": name,
        "policy": policy,
        "about": about,
        "date": date.today().isoformat(),
        "commit": versions()["commit"],
        "means": {metric: round(float(np.mean(scores[metric])), 4) for metric in MEANS},
        "verdict_ci95": {
            title: [round(end, DIGITS) for end in ends]
            for title, ends in verdict_ci95(scores).items()
        },
        "returns": [round(float(value), DIGITS) for value in scores["return"]],
    }


def rows_of(board: Mapping[str, Any]) -> list[list[str]]:
    """The board as a table, best mean return first, with paired differences from the best row."""
    rows = sorted(board["rows"], key=lambda row: -np.mean(row["returns"]))
    table = [["policy", "return", "95 % CI", *SHOWN, "below the first by, 95 % CI", "what"]]
    for row in rows:
        returns, best = np.asarray(row["returns"]), np.asarray(rows[0]["returns"])
        below = best - returns
        cells = [row["name"], short(returns.mean()), interval(bootstrap_ci95(returns))]
        cells += [format(row["means"][metric], ".3f") for metric in SHOWN.values()]
        cells.append("" if row is rows[0] else format_estimate(estimate(below, 0)))
        table.append([*cells, row["about"]])
    return table


def with_row(board: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, Any]:
    """The board with a row added, or replaced if it has one of the same name."""
    others = [other for other in board["rows"] if other["name"] != row["name"]]
    return {**board, "rows": [*others, row]}


def write_board(path: Path, board: Mapping[str, Any]) -> None:
    """Writes a board with one row per line, so that diffs are short; see `_write`."""
    head = {key: value for key, value in board.items() if key != "rows"}
    rows = ",\n".join("  " + json.dumps(row) for row in board["rows"])
    text = json.dumps(head, indent=1).removesuffix("\n}")
    _write(path, f'{text},\n "rows": [\n{rows}\n ]\n}}\n')


def _write(path: Path, text: str) -> None:
    """Writes a text; on failure the process ends with one line and exit code 1."""
    write("python -m benchmarks.leaderboard", path, lambda path: write_text(path, text))


def known_of(board: Mapping[str, Any]) -> dict[str, Any]:
    """The evaluation of medjax's own policies for the player, in the format of `train.evaluate --json`."""
    ours = PRETRAINED, PRETRAINED_SAMPLED, *BASELINES
    rows = [row for row in board["rows"] if row["policy"] in ours]
    policies = {}
    for row in sorted(rows, key=lambda row: -np.mean(row["returns"])):
        found = estimate(np.asarray(row["returns"]), 0)
        policies[row["policy"]] = {
            **{metric: row["means"][metric] for metric in MEANS if metric in NAMES},
            "return_mean": round(found["mean"], DIGITS),
            "return_ci95": [round(end, DIGITS) for end in found["ci95"]],
            "verdict_ci95": row["verdict_ci95"],
        }
    return {**{key: board[key] for key in ("scenario", "seed", "episodes")}, "policies": policies}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Plays the requested policies, writes their rows, prints the board and returns it.

    Raises:
      InputError: bad input.
    """
    board = read_board(options.file)
    if options.again and options.add is not None:
        raise InputError("--again with --add: allowed one or the other")
    if options.policy is not None and options.add is None:
        raise InputError("--policy without --add: allowed --add NAME --policy P")
    name = options.add
    if name is not None and not (name.isprintable() and name.strip()):
        raise InputError(f"--add {shown(name)}: allowed a name")
    todo = [] if name is None else [(name, options.policy or name, options.about)]
    if options.again:
        todo = [(row["name"], row["policy"], row["about"]) for row in board["rows"]]
    if todo:
        check_output("--file", options.file)
    for _, policy, _ in todo:
        check_policy(policy)
    for name, policy, about in todo:
        row = play(board, name, policy, about)
        board = with_row(read_board(options.file), row)  # others may have added rows meanwhile
        write_board(options.file, board)
    if todo and options.file.resolve() == BOARD:
        known = json.dumps(known_of(board), indent=1)
        _write(KNOWN / f"{board['scenario']}.json", known + "\n")
    print(
        f"{board['scenario']}, {board['episodes']} episodes of seed {board['seed']}, the same for all"
    )
    print(format_rows(rows_of(board)))
    return board


def main(arguments: list[str] | None = None) -> None:
    parser = benchmark_parser("leaderboard", __doc__)
    parser.add_argument(
        "--file", type=a_path, default=BOARD, metavar="FILE", help="file of the leaderboard"
    )
    parser.add_argument("--add", metavar="NAME", help="play a policy and add a row under this name")
    parser.add_argument("--policy", metavar="P", help=f"{ALLOWED} (default: NAME)")
    parser.add_argument(
        "--about", default="", metavar="TEXT", help="description of the policy for readers"
    )
    again = "replay every row, as needed after a change of the simulator"
    parser.add_argument("--again", action="store_true", help=again)
    run_command(parser, measure, arguments)
