"""One command for all figures of a GPU; its parts are tested where they are."""

import importlib
import json
import shlex
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.speed import device


def test_without_a_gpu_it_says_what_it_would_run(capsys, monkeypatch):
    real = subprocess.run
    started = []
    monkeypatch.setattr(
        device.subprocess, "run", lambda *a, **b: started.append(a) or real(*a, **b)
    )
    device.main([])
    out = capsys.readouterr().out
    assert "no GPU" in out
    assert all(command in out for command in device.COMMANDS.values())
    assert len(started) == 1  # it asked for the device


def test_each_command_leaves_its_figures_and_a_failure_the_others(tmp_path, capsys, monkeypatch):
    """The file is whole after every command, so that the third finds the first two in it."""
    found = {"backend": "gpu", "device": "a GPU", "jax_version": "0"}
    monkeypatch.setattr(device, "ask_machine", lambda: found)
    file, kept = tmp_path / "all.json", []

    def start(argv, **_):
        kept.append(list(json.loads(file.read_text())["runs"]) if file.exists() else [])
        if "benchmarks.kernels" in argv:
            return SimpleNamespace(returncode=1, stdout="")
        for path in (one.removeprefix("--json=") for one in argv if one.startswith("--json=")):
            Path(path).write_text(json.dumps({"argv": argv[2]}))
        return SimpleNamespace(returncode=0, stdout=f"table of {argv[2]}\n")

    monkeypatch.setattr(device.subprocess, "run", start)
    with pytest.raises(SystemExit) as end:
        device.main([f"--json={file}"])
    assert end.value.code == 1
    runs = json.loads(file.read_text())["runs"]
    assert kept == [list(device.COMMANDS)[:count] for count in range(len(device.COMMANDS))]
    assert list(runs) == list(device.COMMANDS)
    assert (runs["kernels"]["rc"], runs["kernels"]["figures"]) == (1, None)
    assert runs["training"]["figures"] == {"argv": "benchmarks.training"}
    assert runs["tests"]["figures"] is None
    assert "table of benchmarks.training" in capsys.readouterr().out


def test_where_all_succeed_it_does(monkeypatch):
    """And no failure of the tests, the last command, is lost."""
    found = {"backend": "gpu", "device": "a GPU", "jax_version": "0"}
    monkeypatch.setattr(device, "ask_machine", lambda: found)
    codes = dict.fromkeys(device.COMMANDS, 0)
    monkeypatch.setattr(
        device,
        "run",
        lambda name, _: {"command": "", "output": "", "seconds": 1, "rc": codes[name]},
    )
    device.main([])
    codes["tests"] = 5
    with pytest.raises(SystemExit) as end:
        device.main([])
    assert end.value.code == 1


@pytest.mark.parametrize("name", [name for name in device.COMMANDS if name != "tests"])
def test_the_commands_exist_and_take_these_options(name, monkeypatch):
    module, *options = shlex.split(device.COMMANDS[name])
    command = importlib.import_module(module.replace("benchmarks.", "benchmarks.speed."))
    read = []
    monkeypatch.setattr(
        command, "run_command", lambda parser, _, argv: read.append(parser.parse_args(argv))
    )
    command.main([*options, "--json=its.json"])
    assert str(read[0].json) == "its.json"
