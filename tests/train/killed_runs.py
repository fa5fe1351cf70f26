"""`python -m tests.train.killed_runs DIR SEED KILLS`: a run on a probe that is killed and resumed, over and over.

Writes DIR/whole, never interrupted, and DIR/parts, killed KILLS times with SIGKILL at random moments. Prints a line of
JSON after each kill: the contents of the directory. Each start is a process of its own, forked from this one, which
imports everything once and computes nothing.
"""

import json
import os
import random
import shutil
import signal
import sys
import time
import warnings
from pathlib import Path

from tests.train.conftest import TINY, use_probes

UPDATES_PER_LIFE = 100  # more than a process does in its last tenth of a second
OPTIONS = [*TINY, "--checkpoint-interval=1", "--eval-episodes=0", "--num-devices=1"]


def begin(argv: list[str]) -> int:
    """Starts train.ppo in a process of its own; returns its id."""
    if (child := os.fork()) == 0:
        from train import ppo

        use_probes()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os._exit(ppo.main(argv))
    return child


def updates_in(run: Path) -> list[int]:
    """Numbers of the updates in metrics.jsonl, every line of which must be whole."""
    path = run / "metrics.jsonl"
    text = path.read_text() if path.exists() else ""
    assert text == "" or text.endswith("\n"), f"half a line: {text[-80:]!r}"
    return [json.loads(line)["update"] for line in text.splitlines()]


def wait_for_updates(run: Path, child: int) -> None:
    """Waits until metrics.jsonl grows; a process first rewrites it as it was at the checkpoint."""
    path, last = run / "metrics.jsonl", None
    while True:
        if path.exists():
            now = path.stat()
            if last and last.st_ino == now.st_ino and last.st_size < now.st_size:
                return
            last = now
        assert os.waitpid(child, os.WNOHANG) == (0, 0), "it ended by itself"
        time.sleep(0.005)


def main(place: Path, seed: int, kills: int) -> None:
    warnings.filterwarnings("ignore", "os.fork")
    whole, parts = place / "whole", place / "parts"
    options = [*OPTIONS, f"--total-timesteps={16 * UPDATES_PER_LIFE * kills}"]
    child = begin([*options, f"--run-dir={whole}"])
    assert os.waitpid(child, 0)[1] == 0

    rng = random.Random(seed)
    warm_up = 0.0
    for number in range(kills):
        resumes = (parts / "config.json").exists()
        if not resumes:
            shutil.rmtree(parts, ignore_errors=True)
        started = time.monotonic()
        child = begin([f"--resume={parts}"] if resumes else [*options, f"--run-dir={parts}"])
        if number % 3 == 2:  # before the first update, where a process spends most of its time
            time.sleep(rng.uniform(0.0, warm_up))
        else:
            wait_for_updates(parts, child)
            warm_up = time.monotonic() - started
            time.sleep(rng.uniform(0.0, 0.1))
        os.kill(child, signal.SIGKILL)
        assert os.waitpid(child, 0)[1] == signal.SIGKILL
        print(
            json.dumps(
                {"updates": updates_in(parts), "unfinished": len(list(parts.glob("**/*.partial*")))}
            ),
            flush=True,
        )
    assert os.waitpid(begin([f"--resume={parts}"]), 0)[1] == 0


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
