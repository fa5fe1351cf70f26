"""The command that times training: how it starts the others, its table and file, and what ends it."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.speed import training
from tests.benchmarks.refusal import refused

SUMMARY = {
    "compile_s": 10.0,
    "train_s": 20.0,
    "evaluation_s": 5.0,
    "env_steps": 409600,
    "backend": "cpu",
    "device": "cpu",
}
PACES = (9000.0, 20_480.0, 21_000.0)  # decisions/s of its updates


def test_parts_add_up_to_the_total():
    parts = {"compile_s": 10.0, "train_s": 20.0, "evaluation_s": 5.0, "other_s": 3.0}
    wall = training.split(SUMMARY, PACES, 38.0)
    assert wall == {"total_s": 38.0, **parts, "decisions_per_s": 20480.0}


def test_medians_are_of_each_figure():
    names = training.split(SUMMARY, PACES, 38.0)
    figures = (1, 9, 1, 1, 1, 5), (3, 7, 3, 3, 3, 1), (2, 8, 9, 2, 2, 9)
    walls = [dict(zip(names, each, strict=True)) for each in figures]
    assert training.median(walls) == dict(zip(names, (2, 8, 3, 2, 2, 5), strict=True))


@pytest.fixture
def commands(monkeypatch):
    """Commands and environments of processes that leave what they are asked for.

    Totals are 40, 50, 60 s cold and 20 s less warm; the simulator is faster.
    """
    calls, caches, alone = [], [], iter((25_600.0, 20_480.0, 40_960.0))

    def run(command, env, **_):
        calls.append((command, env))
        options = dict(each.split("=", 1) for each in command[3:])
        if "--run-dir" not in options:
            file = Path(options["--json"])
            file.write_text(json.dumps({"env_steps_per_s": next(alone)}))
            return subprocess.CompletedProcess(command, 0, "", "")
        caches.append(env["JAX_COMPILATION_CACHE_DIR"])
        path = Path(options["--run-dir"])
        path.mkdir(parents=True)
        compile_s = 1.0 if caches.count(caches[-1]) == 2 else 10.0
        (path / "summary.json").write_text(json.dumps(SUMMARY | {"compile_s": compile_s}))
        rows = [{"update": 1 + i, "env_steps_per_s": pace} for i, pace in enumerate(PACES)]
        (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
        return subprocess.CompletedProcess(command, 0, "", "")

    clock = iter((0.0, 40.0, 0.0, 20.0, 0.0, 50.0, 0.0, 30.0, 0.0, 60.0, 0.0, 40.0))
    monkeypatch.setattr(training.subprocess, "run", run)
    monkeypatch.setattr(training, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    return calls


def test_table_of_cold_and_warm_starts(commands, tmp_path, capsys):
    """Each repeat has a cache of its own, and its warm start the same one; ratios are of one repeat."""
    file = tmp_path / "training.json"
    argv = ["--repeats=3", "--seed=7", "--num-envs=128", "--total-timesteps=4e5"]
    assert training.main([*argv, f"--json={file}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("409,600 decisions of paper, 128 environments, cpu")
    assert lines[2].split() == [*training.HEADINGS, "decisions/s"]
    assert lines[3].split() == ["cold", "50.0", "10.0", "20.0", "5.0", "15.0", "20,480"]
    assert lines[4].split() == ["warm", "30.0", "1.0", "20.0", "5.0", "4.0", "20,480"]
    assert len({len(line) for line in lines[2:5]}) == 1
    assert lines[-1] == "without learning 25,600 decisions/s; training has 0.80 of them"
    written = json.loads(file.read_text())
    assert written["cold"]["total_s"] == 50.0
    assert [wall["total_s"] for wall in written["runs"]["warm"]] == [20.0, 30.0, 40.0]
    assert written["by_throughput"] == pytest.approx(0.8)

    trained = [(words, env) for words, env in commands if words[2] == "train.ppo"]
    caches = [env["JAX_COMPILATION_CACHE_DIR"] for _, env in trained]
    assert (len(trained), len(set(caches)), caches[::2]) == (6, 3, caches[1::2])
    passed = {"--scenario=paper", "--num-envs=128", "--total-timesteps=400000", "--seed=7"}
    for words, _ in trained:
        assert words[:2] == [sys.executable, "-m"]
        assert passed == {word for word in words[3:] if not word.startswith("--run-dir=")}
    alone = [words for words, _ in commands if words[2] == "benchmarks.throughput"]
    assert len(alone) == 3
    for words in alone:
        assert {"--num-envs=128", "--scenario=paper"} < set(words[3:])
        assert len(words[3:]) == 3


def test_a_command_that_fails_ends_it_with_its_last_line(monkeypatch, capsys):
    """With code 1, and nothing on stdout."""

    def fail(command, **_):
        return subprocess.CompletedProcess(command, 1, "training paper\n", "Traceback\nboom\n\n")

    monkeypatch.setattr(training.subprocess, "run", fail)
    assert training.main([]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "python -m benchmarks.training: train.ppo ended with code 1: boom\n"


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["--num-envs=0"], "num_envs is 0"),
        (["--num-envs=1048577"], "num_envs is 1048577, allowed: at least 1, at most 1048576"),
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
