"""The command that times training: its table and file, and what ends it."""

import json
import subprocess

import pytest

from benchmarks.speed import training, training_process
from tests.benchmarks.refusal import refused
from tests.benchmarks.speed.made_runs import PACES, SUMMARY, write_run


@pytest.fixture
def scripted(monkeypatch):
    """Commands that leave hand-made run directories: 40, 50, 60 s cold and 20 s less warm; the simulator is faster."""
    caches, alone = [], iter((25_600.0, 20_480.0, 40_960.0))

    def start(config, run_dir, cache):
        caches.append(cache)
        total_s = 30.0 + 10.0 * len(set(caches))
        warm = caches.count(cache) == 2
        summary = SUMMARY | {"compile_s": 1.0 if warm else 10.0}
        write_run(run_dir.path, summary)
        return training_process.split(summary, PACES, total_s - 20.0 if warm else total_s)

    monkeypatch.setattr(training, "start", start)
    monkeypatch.setattr(training, "throughput", lambda config, file: next(alone))
    return caches


def test_table_of_cold_and_warm_starts(scripted, tmp_path, capsys):
    """Each repeat has a cache of its own, and its warm start the same one; ratios are of one repeat."""
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
    assert lines[-1] == "without learning 25,600 decisions/s; training has 0.80 of them"
    written = json.loads(file.read_text())
    assert written["cold"]["total_s"] == 50.0
    assert [wall["total_s"] for wall in written["runs"]["warm"]] == [20.0, 30.0, 40.0]
    assert written["by_throughput"] == pytest.approx(0.8)


def test_a_command_that_fails_ends_it_with_its_last_line(monkeypatch, capsys):
    """With code 1, and nothing on stdout."""

    def fail(command, **_):
        return subprocess.CompletedProcess(command, 1, "training paper\n", "Traceback\nboom\n\n")

    monkeypatch.setattr(training_process.subprocess, "run", fail)
    assert training.main([]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "python -m benchmarks.training: train.ppo ended with code 1: boom\n"


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--num-envs=0"], "num_envs is 0"),
        (["--num-envs=10"], "multiple of 16"),
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
def test_the_real_commands(tmp_path, capsys):
    """A whole episode of 64 environments: the warm start compiles less, and the simulator alone is faster."""
    file = tmp_path / "training.json"
    argv = ["--num-envs=64", "--total-timesteps=32000", f"--json={file}"]
    assert training.main(argv) == 0
    result = json.loads(file.read_text())
    assert result["env_steps"] == 38_400
    for name in ("cold", "warm"):
        wall = result[name]
        assert all(value > 0 for value in wall.values())
        parts = ("compile_s", "train_s", "evaluation_s", "other_s")
        assert sum(wall[part] for part in parts) == pytest.approx(wall["total_s"])
    assert result["warm"]["compile_s"] < 0.5 * result["cold"]["compile_s"]
    assert 0.1 < result["by_throughput"] < 1.2
    assert capsys.readouterr().out.splitlines()[-1].startswith("without learning ")
