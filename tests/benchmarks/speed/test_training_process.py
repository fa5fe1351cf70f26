"""How the training command is started, and the parts of its wall time."""

import subprocess
import sys

from benchmarks.speed import training_process
from benchmarks.speed.training import settings
from benchmarks.speed.training_process import Wall
from tests.benchmarks.speed.made_runs import SUMMARY, write_run
from train.runs.run_directory import RunDir


def test_parts_add_up_to_the_total():
    wall = training_process.split(SUMMARY, 38.0)
    assert wall == Wall(38.0, 10.0, 20.0, 5.0, other_s=3.0, decisions_per_s=20480.0)


def test_medians_are_of_each_figure():
    walls = [Wall(1, 9, 1, 1, 1, 5), Wall(3, 7, 3, 3, 3, 1), Wall(2, 8, 9, 2, 2, 9)]
    assert training_process.median(walls) == Wall(2, 8, 3, 2, 2, 5)


def test_the_command_is_started_as_asked(monkeypatch, tmp_path):
    """In this Python, with the cache that it is given, checkpoints spread and all kept."""
    seen = {}

    def run(command, env, **_):
        seen.update(command=command, env=env)
        write_run(tmp_path / "run", SUMMARY, 0.5, 10.0)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(training_process.subprocess, "run", run)
    given = {"num_envs": "128", "total_timesteps": "4e5", "scenario": "paper", "seed": "7"}
    wall = training_process.start(settings(given), RunDir(tmp_path / "run"), tmp_path / "cache")
    assert wall.compile_s == 10.0
    assert seen["command"][:3] == [sys.executable, "-m", "train.ppo"]
    assert set(seen["command"][3:]) == {
        f"--run-dir={tmp_path / 'run'}",
        "--scenario=paper",
        "--num-envs=128",
        "--total-timesteps=400000",
        "--seed=7",
        "--checkpoint-interval=1",  # of 6 updates of 128 whole episodes
        "--keep-checkpoints=6",
    }
    assert seen["env"]["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "cache")
