"""Runs killed with SIGKILL at random moments resume from their last checkpoint and end as if uninterrupted."""

import json
import subprocess
import sys

import pytest

from tests.train.runs.test_session import assert_same_run


@pytest.mark.parametrize(
    "kills", [pytest.param(6, marks=pytest.mark.thorough), pytest.param(20, marks=pytest.mark.slow)]
)
def test_killed_and_resumed_equals_uninterrupted_bit_for_bit(probe, request, kills):
    command = [sys.executable, "-m", "tests.train.killed_runs", str(probe), "0", str(kills)]
    done = subprocess.run(command, cwd=request.config.rootpath, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    deaths = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(deaths) == kills
    for death in deaths:  # no update twice, none left out
        assert death["updates"] == list(range(1, len(death["updates"]) + 1))
    if kills == 20:  # enough that some died while a checkpoint was written
        assert any(death["unfinished"] for death in deaths)
    assert_same_run(probe / "whole", probe / "parts")
