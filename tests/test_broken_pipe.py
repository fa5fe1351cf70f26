"""A command goes on and writes its files after the reader of its output, such as `head`, has gone."""

import json
import shlex
import subprocess
import sys

import pytest

from tests.documented import ROOT
from tests.train.conftest import TINY


def run_unread(folder, *words, lines=1):
    """Runs `python -m` while its reader of stdout and stderr goes away after some lines; returns the exit code."""
    command = [sys.executable, "-u", "-m", *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, cwd=folder, text=True, **pipes) as process:
        for _ in range(lines):
            process.stdout.readline()
        process.stdout.close()
        return process.wait(timeout=300)


@pytest.mark.thorough
def test_training_goes_on_and_is_saved(tmp_path):
    """After two lines of six updates on a probe; the trained policy is saved and evaluated."""
    run = tmp_path / "run"
    assert run_unread(ROOT, "tests.train.probe_run", *TINY, "--run-dir", run, lines=2) == 0
    assert len((run / "metrics.jsonl").read_text().splitlines()) == 6
    assert json.loads((run / "summary.json").read_text())["env_steps"] == 96
    assert list((run / "checkpoints").iterdir())


@pytest.mark.thorough
def test_the_file_of_an_episode_is_written(tmp_path):
    file = tmp_path / "run.csv"
    words = ["medjax.trajectories", "--policy", "none", "--set", "episode_decisions=3"]
    assert run_unread(tmp_path, *words, "--out", file, lines=0) == 0
    assert file.stat().st_size > 1000


SPEAKS = """
import sys
from tqdm import tqdm
from medjax.commandline import command

@command
def main(argv):
    for number in range(20_000):
        print(number)
        print(number, file=sys.stderr)
    sys.stderr.isatty()
    list(tqdm(range(3), disable=None))
    open("done", "w").close()
    return 3

sys.exit(main())
"""


def test_any_command_goes_on(tmp_path):
    """It prints far more than a pipe holds to both streams, and keeps its own exit code."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    assert run_unread(tmp_path, "speaks") == 3
    assert (tmp_path / "done").exists()


def run_closed(folder, words, closed):
    """Runs `python -m` with closed streams, of which Python makes None; returns the exit code."""
    shell = f"{shlex.quote(sys.executable)} -m {words} {closed}"
    return subprocess.run(shell, shell=True, cwd=folder, check=False, timeout=300).returncode


@pytest.mark.parametrize("closed", [">&- 2>&-", "2>&- >out"])
def test_a_command_without_streams_goes_on(tmp_path, closed):
    """So does a progress bar, which writes unasked; what goes to a closed stream is in no other."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    assert run_closed(tmp_path, "speaks", closed) == 3
    assert (tmp_path / "done").exists()
    if (out := tmp_path / "out").exists():
        assert [*map(int, out.read_text().split())] == [*range(20_000)]


@pytest.mark.thorough
def test_training_without_stderr_is_saved(tmp_path):
    words = ["tests.train.probe_run", *TINY, "--run-dir", tmp_path / "run"]
    assert run_closed(ROOT, shlex.join(map(str, words)), ">/dev/null 2>&-") == 0
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["env_steps"] == 96
