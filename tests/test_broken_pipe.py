"""A reader of a command's output that goes away, as `head` does, ends neither the work nor its files."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

from tests.train.conftest import TINY

ROOT = Path(__file__).parents[1]


def run_unread(folder, *words, lines=1):
    """Runs `python -m` with a reader of stdout and stderr that goes away after some lines; the exit code."""
    with subprocess.Popen(
        [sys.executable, "-u", "-m", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder,
        text=True,
    ) as process:
        for _ in range(lines):
            process.stdout.readline()
        process.stdout.close()
        return process.wait(timeout=300)


def test_training_goes_on_and_is_saved(tmp_path):
    """Six updates on a probe, read for two lines; what was trained is saved and evaluated."""
    run = tmp_path / "run"
    assert run_unread(ROOT, "tests.train.probe_run", *TINY, "--run-dir", run, lines=2) == 0
    assert len((run / "metrics.jsonl").read_text().splitlines()) == 6
    assert json.loads((run / "summary.json").read_text())["env_steps"] == 96
    assert list((run / "checkpoints").iterdir())


def test_a_file_of_an_episode_is_written(tmp_path):
    file = tmp_path / "run.csv"
    words = ["medjax.trajectories", "--policy", "none", "--set", "episode_decisions=3"]
    assert run_unread(tmp_path, *words, "--out", file, lines=0) == 0
    assert file.stat().st_size > 1000


SPEAKS = """
import sys
from medjax.commandline import command

@command
def main(argv):
    for number in range(20_000):
        print(number)
        print(number, file=sys.stderr)
    open("done", "w").close()
    return 3

sys.exit(main())
"""


def test_any_command_goes_on(tmp_path):
    """Far more than a pipe holds, to both streams, and its own exit code."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    assert run_unread(tmp_path, "speaks") == 3
    assert (tmp_path / "done").exists()


def test_a_command_without_streams_goes_on(tmp_path):
    """As a shell's `>&-` starts it: Python has None for them."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    shell = f"{shlex.quote(sys.executable)} -m speaks >&- 2>&-"
    assert subprocess.run(shell, shell=True, cwd=tmp_path, check=False, timeout=60).returncode == 3
    assert (tmp_path / "done").exists()
