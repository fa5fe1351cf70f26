"""How benchmark commands write their results and end."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.command import add_plot, benchmark_parser, run_command
from medjax.errors import InputError
from tests.benchmarks.refusal import refused

ROOT = Path(__file__).parents[2]


def parser():
    found = benchmark_parser("example", "An example.")
    add_plot(found, "it")
    return found


def test_results_and_picture_are_written_only_if_asked_for(tmp_path):
    file, picture = tmp_path / "out.json", tmp_path / "out.png"
    drawn = []
    plot = lambda path, result: drawn.append((path, result))  # noqa: E731
    assert run_command(parser(), lambda options: {"x": 1}, [], plot) == {"x": 1}
    assert not [*tmp_path.iterdir(), *drawn]
    run_command(parser(), lambda options: {"x": 1}, [f"--json={file}", f"--plot={picture}"], plot)
    assert json.loads(file.read_text()) == {"x": 1}
    assert drawn == [(picture, {"x": 1})]


def test_results_are_json_that_anything_reads(tmp_path):
    """JSON has no NaN and no infinity, wherever they are in a report; null stands for them."""
    file, bad = tmp_path / "out.json", float("nan")
    report = {"a": bad, "b": [1.5, (float("-inf"), "x")], "c": {"d": np.float64("inf"), "e": None}}
    run_command(parser(), lambda options: report, [f"--json={file}"])
    strict = {"parse_constant": pytest.fail}
    expected = {"a": None, "b": [1.5, [None, "x"]], "c": {"d": None, "e": None}}
    assert json.loads(file.read_text(), **strict) == expected


def test_bad_input_found_while_measuring_is_one_line(capsys):
    def measure(options):
        raise InputError("x is 3, allowed: 4")

    error = refused(lambda argv: run_command(parser(), measure, argv), [], capsys)
    assert error == "python -m benchmarks.example: x is 3, allowed: 4\n"


def test_other_errors_are_raised():
    def measure(options):
        raise ValueError("shapes differ")

    with pytest.raises(ValueError, match="shapes differ"):
        run_command(parser(), measure, [])


def test_a_file_that_can_no_longer_be_written_is_one_line(tmp_path, capsys):
    """Its place is checked before; it may be gone after."""
    folder = tmp_path / "gone"
    folder.mkdir()

    def measure(options):
        folder.rmdir()
        return {}

    argv = [f"--json={folder / 'out.json'}"]
    with pytest.raises(SystemExit) as end:
        run_command(parser(), measure, argv)
    assert end.value.code == 1
    line = f"cannot write {folder / 'out.json'}: No such file or directory"
    assert capsys.readouterr().err == f"python -m benchmarks.example: {line}\n"


@pytest.mark.thorough
def test_a_users_own_train_module_is_not_run(tmp_path):
    """Python looks into the current folder first; with -P it does not."""
    (tmp_path / "train.py").write_text("print('mine')")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    words = ["-m", "benchmarks.leaderboard", "--help"]

    def run(*options):
        command = [sys.executable, *options, *words]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=tmp_path, env=environment
        )

    ended = run()
    assert (ended.returncode, ended.stdout) == (2, "")
    remedy = "allowed in another folder, or as python -P -m benchmarks.leaderboard"
    said = f"train is {tmp_path / 'train.py'} here: {remedy}"
    assert ended.stderr == f"python -m benchmarks.leaderboard: {said}\n"
    assert run("-P").returncode == 0


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_it_in_a_line(name):
    code = (
        "import signal\n"
        "from benchmarks.command import benchmark_parser, run_command\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "parser = benchmark_parser('example', 'An example.')\n"
        f"run_command(parser, lambda options: signal.raise_signal(signal.{name}), [])\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode == 128 + getattr(signal, name)
    assert (ended.stdout, ended.stderr) == ("", "interrupted\n")
