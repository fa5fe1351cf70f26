"""Runs killed with SIGKILL at random moments go on from their last checkpoint as if nothing had been."""

import json
import subprocess
import sys

from tests.train.test_session import assert_same_run

KILLS = 20


def test_killed_twenty_times_and_resumed_equals_uninterrupted_bit_for_bit(probe, request):
    command = [sys.executable, "-m", "tests.train.killed_runs", str(probe), "0", str(KILLS)]
    done = subprocess.run(command, cwd=request.config.rootpath, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    deaths = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(deaths) == KILLS
    for death in deaths:  # no update twice, none left out
        assert death["updates"] == list(range(1, len(death["updates"]) + 1))
    assert any(death["unfinished"] for death in deaths)  # some while a checkpoint was written
    assert_same_run(probe / "whole", probe / "parts")
