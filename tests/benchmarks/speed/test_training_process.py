"""How the training command is started, and the parts of its wall time."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.speed import training_process
from benchmarks.speed.training import settings
from benchmarks.speed.training_process import Wall
from tests.benchmarks.speed.made_runs import PACES, SUMMARY, write_run
from train.runs.run_directory import RunDir


def test_parts_add_up_to_the_total():
    wall = training_process.split(SUMMARY, PACES, 38.0)
    assert wall == Wall(38.0, 10.0, 20.0, 5.0, other_s=3.0, decisions_per_s=20480.0)


def test_medians_are_of_each_figure():
    walls = [Wall(1, 9, 1, 1, 1, 5), Wall(3, 7, 3, 3, 3, 1), Wall(2, 8, 9, 2, 2, 9)]
    assert training_process.median(walls) == Wall(2, 8, 3, 2, 2, 5)


@pytest.fixture
def seen(monkeypatch):
    """Commands and environments of processes that leave what they are asked for."""
    calls = []

    def run(command, env, **_):
        calls.append((command, env))
        options = dict(each.split("=", 1) for each in command[3:])
        if "--run-dir" in options:
            write_run(Path(options["--run-dir"]), SUMMARY)
        else:
            Path(options["--json"]).write_text('{"env_steps_per_s": 25000.0}')
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(training_process.subprocess, "run", run)
    return calls


def test_the_commands_are_started_as_asked(seen, tmp_path):
    """In this Python, training with the cache that it is given, the simulator with as many environments."""
    given = {"num_envs": "128", "total_timesteps": "4e5", "scenario": "paper", "seed": "7"}
    wall = training_process.start(settings(given), RunDir(tmp_path / "run"), tmp_path / "cache")
    assert wall.compile_s == 10.0
    assert wall.decisions_per_s == 20_480.0
    assert training_process.throughput(settings(given), tmp_path / "alone.json") == 25_000.0
    (train, where), (alone, _) = seen
    assert train[:3] == [sys.executable, "-m", "train.ppo"]
    assert set(train[3:]) == {
        f"--run-dir={tmp_path / 'run'}",
        "--scenario=paper",
        "--num-envs=128",
        "--total-timesteps=400000",
        "--seed=7",
    }
    assert where["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "cache")
    assert alone[:3] == [sys.executable, "-m", "benchmarks.throughput"]
    assert set(alone[3:]) == {
        "--num-envs=128",
        "--scenario=paper",
        f"--json={tmp_path / 'alone.json'}",
    }
