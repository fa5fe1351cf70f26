"""The parts of a run's wall time, when greedy counts as beaten, and the command."""

import json
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.speed import training
from benchmarks.speed.training import Checkpoint, Wall
from tests.benchmarks.refusal import refused
from train.runs.run_directory import RunDir

SUMMARY = {
    "compile_s": 10.0,
    "train_s": 20.0,
    "evaluation_s": 5.0,
    "env_steps": 409600,
    "env_steps_per_s": 20480.0,
    "backend": "cpu",
    "device": "cpu",
}


def write_run(path, summary, update_s, from_s):
    """A run directory as train.ppo leaves it, with 25 updates; no whole episode ended."""
    path.mkdir(parents=True)
    (path / "summary.json").write_text(json.dumps(summary))
    rows = [
        {"update": n, "wall_s": from_s + update_s * n, "episode_return": None} for n in range(1, 26)
    ]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return RunDir(path)


def test_parts_add_up_to_the_total():
    wall = training.split(SUMMARY, 38.0)
    assert wall == Wall(38.0, 10.0, 20.0, 5.0, other_s=3.0, decisions_per_s=20480.0)


def test_medians_are_of_each_figure():
    walls = [Wall(1, 9, 1, 1, 1, 5), Wall(3, 7, 3, 3, 3, 1), Wall(2, 8, 9, 2, 2, 9)]
    assert training.median(walls) == Wall(2, 8, 3, 2, 2, 5)


def test_time_of_an_update_is_its_line_of_the_metrics(tmp_path):
    run_dir = write_run(tmp_path / "run", SUMMARY, update_s=0.5, from_s=10.0)
    assert training.reached_s(run_dir, 8) == 14.0


def test_a_checkpoint_is_compared_in_pairs():
    """Episodes differ by hundreds, the policies by 5 +- 1 in each: plainly above, and plainly below."""
    rng = np.random.default_rng(0)
    greedy = rng.normal(-150.0, 300.0, 64)
    ours = greedy + rng.normal(5.0, 1.0, 64)
    point = training.compare(12, ours, greedy, seed=0)
    assert point.update == 12
    assert point.return_mean == pytest.approx(ours.mean())
    low, high = point.gain_ci95
    assert 4.4 < low < 5.0 < high < 5.6
    assert training.compare(12, greedy, ours, seed=0).gain_ci95[1] < 0


def test_first_beaten_is_the_first_surely_above():
    """A mean above greedy is not enough, nor is a bound of 0; what comes later does not matter."""
    below = Checkpoint(4, -200.0, (-60.0, -40.0))
    unsure = Checkpoint(8, -140.0, (-5.0, 25.0))
    equal = Checkpoint(12, -150.0, (0.0, 0.0))
    above = Checkpoint(16, -120.0, (20.0, 40.0))
    again = Checkpoint(20, -160.0, (-20.0, 0.5))
    assert training.first_beaten([below, unsure, equal, above, again]) is above
    assert training.first_beaten([below, unsure, equal, again]) is None
    assert training.first_beaten([]) is None


@pytest.fixture
def scripted(monkeypatch):
    """Commands that leave hand-made run directories: 40, 50, 60 s cold and 20 s less warm."""
    caches = []

    def start(config, run_dir, cache):
        caches.append(cache)
        total_s = 30.0 + 10.0 * len(set(caches))
        warm = caches.count(cache) == 2
        summary = SUMMARY | {"compile_s": 1.0 if warm else 10.0}
        write_run(run_dir.path, summary, update_s=0.5, from_s=1.0 if warm else 10.0)
        return training.split(summary, total_s - 20.0 if warm else total_s)

    monkeypatch.setattr(training, "start", start)
    return caches


def play(curve):
    return lambda run_dir: (-150.0, curve)


def test_table_of_cold_and_warm_starts(scripted, monkeypatch, tmp_path, capsys):
    """Each repeat has a cache of its own, and its warm start the same one."""
    curve = [Checkpoint(4, -140.0, (-5.0, 25.0)), Checkpoint(8, -120.0, (20.0, 40.0))]
    monkeypatch.setattr(training, "play_checkpoints", play(curve))
    file = tmp_path / "training.json"
    assert training.main(["--repeats=3", f"--json={file}"]) == 0
    assert len(scripted) == 6
    assert len(set(scripted)) == 3
    assert scripted[::2] == scripted[1::2]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("409,600 decisions of paper, 256 environments, cpu")
    assert lines[2].split() == [*training.HEADINGS, "decisions/s"]
    assert lines[3].split() == ["cold", "50.0", "10.0", "20.0", "5.0", "15.0", "20,480"]
    assert lines[4].split() == ["warm", "30.0", "1.0", "20.0", "5.0", "4.0", "20,480"]
    assert len({len(line) for line in lines[2:5]}) == 1
    assert lines[-1] == (
        "greedy beaten after 14.0 s, warm 5.0 s (update 8, return -120.0 against -150.0)"
    )
    written = json.loads(file.read_text())
    assert written["cold"]["total_s"] == 50.0
    assert [wall["total_s"] for wall in written["runs"]["warm"]] == [20.0, 30.0, 40.0]
    assert written["greedy_beaten"]["update"] == 8
    assert [point["update"] for point in written["checkpoints"]] == [4, 8]


def test_greedy_never_beaten_is_said(scripted, monkeypatch, tmp_path, capsys):
    curve = [Checkpoint(4, -200.0, (-60.0, -40.0)), Checkpoint(25, -145.0, (-5.0, 15.0))]
    monkeypatch.setattr(training, "play_checkpoints", play(curve))
    file = tmp_path / "training.json"
    assert training.main([f"--json={file}"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == "greedy not beaten (last update 25, return -145.0 against -150.0)"
    assert json.loads(file.read_text())["greedy_beaten"] is None


def test_a_command_that_fails_ends_it_with_its_last_line(monkeypatch, capsys):
    """With code 1, and nothing on stdout."""

    def fail(command, **_):
        return subprocess.CompletedProcess(command, 1, "training paper\n", "Traceback\nboom\n\n")

    monkeypatch.setattr(training.subprocess, "run", fail)
    assert training.main([]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "python -m benchmarks.training: train.ppo ended with code 1: boom\n"


def test_the_command_is_started_as_asked(monkeypatch, tmp_path):
    """In this Python, with the cache that it is given, checkpoints spread and all kept."""
    seen = {}

    def run(command, env, **_):
        seen.update(command=command, env=env)
        write_run(tmp_path / "run", SUMMARY, 0.5, 10.0)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(training.subprocess, "run", run)
    given = {"num_envs": "128", "total_timesteps": "4e5", "scenario": "paper", "seed": "7"}
    wall = training.start(training.settings(given), RunDir(tmp_path / "run"), tmp_path / "cache")
    assert wall.compile_s == 10.0
    assert seen["command"][:3] == [sys.executable, "-m", "train.ppo"]
    assert set(seen["command"][3:]) == {
        f"--run-dir={tmp_path / 'run'}",
        "--scenario=paper",
        "--num-envs=128",
        "--total-timesteps=400000",
        "--seed=7",
        "--checkpoint-interval=4",  # 25 updates: 4, 8, ..., 24, and the last
        "--keep-checkpoints=25",
    }
    assert seen["env"]["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "cache")


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--num-envs=0"], "num_envs is 0"),
        (["--num-envs=10"], "multiple of 32"),
        (["--num-envs=many"], "'many'"),
        (["--total-timesteps=-5"], "total_timesteps is -5"),
        (["--seed=-1"], "seed is -1"),
        (["--scenario=nowhere"], "nowhere"),
        (["--repeats=0"], "'0': allowed"),
        (["--json=/no/such/folder/training.json"], "allowed a file"),
        (["--frobnicate"], "--frobnicate"),
    ],
)
def test_bad_input_is_one_line_and_code_2(argv, word, capsys):
    assert word in refused(training.main, argv, capsys)


@pytest.mark.slow
def test_the_real_command(tmp_path, capsys):
    """Four updates of 64 environments: the warm start compiles less, and checkpoints are played in order."""
    file = tmp_path / "training.json"
    argv = ["--num-envs=64", "--total-timesteps=32000", f"--json={file}"]
    assert training.main(argv) == 0
    result = json.loads(file.read_text())
    assert result["env_steps"] == 32768
    for name in ("cold", "warm"):
        wall = result[name]
        assert all(value > 0 for value in wall.values())
        parts = ("compile_s", "train_s", "evaluation_s", "other_s")
        assert sum(wall[part] for part in parts) == pytest.approx(wall["total_s"])
    assert result["warm"]["compile_s"] < 0.5 * result["cold"]["compile_s"]
    assert [point["update"] for point in result["checkpoints"]] == [1, 2, 3, 4]
    assert -400.0 < result["greedy_return_mean"] < 0.0
    assert capsys.readouterr().out.splitlines()[-1].startswith("greedy ")
