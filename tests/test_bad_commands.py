"""Bad files and options of every command: one clear line, exit code 2, no file written, nothing compiled."""

import contextlib
import importlib
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from medjax import commandline
from medjax.world.params import SIZES
from tests.bad_texts import FILES, PATHS, TEXTS
from tests.benchmarks.studies.price_rows import ISO, rows, text_of
from tests.documented import NUMBERS, ROOT
from tests.refusals import MOST_S, AcceptedError, check_line
from tests.test_bad_input import (
    FIELDS,
    LEAVES,
    TOGETHER,
    arguments,
    leaves_of,
    overrides_of,
    settings_of,
    sizes_of,
    structures,
)
from tests.train.conftest import exit_code

pytestmark = pytest.mark.usefixtures("nothing_starts")


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A working directory with the entries that `PATHS` names."""
    (tmp_path / "work/used").mkdir(parents=True)
    work = tmp_path / "work"
    (work / "used/notes.txt").write_text("precious")
    (work / "file").write_text("precious")
    (work / "loop").symlink_to("loop")
    (work / "dangling").symlink_to("nowhere")
    (work / "run").mkdir()
    (work / "run/config.json").write_text('{"config": {}, "versions": {}}')
    (work / "run/checkpoints").mkdir()
    # Commands ask whether there is a checkpoint, and `nothing_starts` stops them before they read it.
    (work / "run/checkpoints/1.npz").write_text("")
    (work / "prices.csv").write_text(text_of(*rows((2024, 1, 1), (2024, 12, 31), ISO)))
    (work / "policy").mkdir()
    (work / "policy/policy.zip").write_text("no zip")
    monkeypatch.chdir(work)
    return work


def tree(root):
    return sorted((str(path), path.lstat().st_size) for path in root.rglob("*"))


def not_refused_by(name, argvs, work, capsys, *words):
    """Describes each command line that was not refused in one line or that changed a file."""
    command = importlib.import_module(name)
    before, wrong = tree(work), []
    for argv in argvs:
        start, code = time.process_time(), None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                code = exit_code(command, argv)
            took = time.process_time() - start
            out, err = capsys.readouterr()
            assert code == 2, code
            assert out == ""
            assert err.count("\n") == 1, err
            check_line(err[:-1], *words)
            assert took < MOST_S, took
            assert tree(work) == before
        except (AcceptedError, AssertionError, Exception) as error:
            capsys.readouterr()
            wrong.append(f"{ascii(argv)[:150]}: {type(error).__name__} {str(error)[:200]}")
    return wrong


@pytest.mark.parametrize("name", FILES)
def test_bad_files(name, work, capsys):
    for text in [*(text.encode() for text in FILES[name]), b"\xff\xfe\x80"]:
        Path(name).write_bytes(text)
        argv = [f"--config={name}", "--run-dir=new"]
        assert not not_refused_by("train.ppo", [argv], work, capsys, name)


# The command lines.

COMMANDS = {
    "train.ppo": [],
    "train.evaluate": ["--run-dir=run"],
    "train.report": ["--run-dir=run"],
    "train.export": ["--run-dir=run"],
    "medjax.render.__main__": ["--out=new.png"],
    "medjax.trajectories": ["--out=new.csv"],
    "benchmarks.studies.agents": [],
    "benchmarks.studies.calibrate": [],
    "benchmarks.studies.generalization": ["--run-dir=run"],
    "benchmarks.speed.cost": [],
    "benchmarks.speed.device": [],
    "benchmarks.speed.kernels": [],
    "benchmarks.peers.__main__": [],
    "benchmarks.studies.planner": [],
    "benchmarks.studies.prices": ["prices.csv"],
    "benchmarks.speed.scaling": [],
    "benchmarks.speed.throughput": [],
    "benchmarks.verification.own_road.compare": [],
    "benchmarks.speed.training": [],
    "benchmarks.studies.ticks": [],
    "benchmarks.studies.tune": [],
    "benchmarks.studies.worth.command": [],
    "benchmarks.studies.ablation.__main__": ["cooldown"],
    "benchmarks.verification.golden": ["--out=new.npz"],
}
ALWAYS = (
    *("--frobnicate", "--frobnicate=1", "-x", "positional", "-", "--=", "--\ud800", "--seed=1=2"),
    *("\n", "x" * 100_000),
)
FILE_OPTIONS = ("json", "plot", "out", "keep")
DIRECTORY_OPTIONS = ("run_dir", "resume", "config")


def options_of(name):
    """Options of a command's parser by their `dest`."""
    found = {}

    def stop(parser, args=None, namespace=None):
        found.update({action.dest: action for action in parser._actions if action.option_strings})
        raise AcceptedError

    with pytest.MonkeyPatch.context() as patch, contextlib.suppress(AcceptedError):
        patch.setattr(commandline.OneLineParser, "parse_args", stop)
        importlib.import_module(name).main([])
    return found


def bad_lines(name, options):
    """Command lines with one fault each."""
    start = COMMANDS[name]
    lines = [[*start, word] for word in ALWAYS]
    for dest, action in options.items():
        flag = action.option_strings[0]
        if dest == "help":
            continue
        if action.nargs == 0:
            texts = ["", "x", "true"]
        elif dest in FILE_OPTIONS:
            texts = [text for text in PATHS if text not in ("file", "file/", "loop", "dangling")]
        elif dest in DIRECTORY_OPTIONS:
            texts = PATHS
        else:
            texts = TEXTS
            lines.append([*start, flag])
        own = [word for word in start if word != f"{flag}=run"]
        lines += [[*own, f"{flag}={text}"] for text in texts]
    return lines


@pytest.mark.parametrize("name", [name for name, words in COMMANDS.items() if words])
def test_good_command_lines_are_accepted(name, work):
    """Else a command line would be refused whatever follows."""
    with contextlib.suppress(AcceptedError):
        assert exit_code(importlib.import_module(name), COMMANDS[name]) in (0, None)


@pytest.mark.parametrize("name", COMMANDS)
def test_bad_command_lines(name, work, capsys):
    assert not not_refused_by(name, bad_lines(name, options_of(name)), work, capsys)


RAW = [
    *(["--run-dir", b"\xff\xfe"], ["--run-dir", "a\nb"], ["--run-dir", "x" * 300]),
    *(["--run-dir", ""], ["--run-dir", "loop/run"], ["--set", b"cooldown_s=\xff"], ["--set=--"]),
    *([b"--\xff\x1b[2J"], ["--config", "/dev/zero"], ["--config", "loop"]),
    *(["--resume", "dangling"], ["--lr", "9" * 100_000]),
]


@pytest.mark.thorough
@pytest.mark.parametrize("argv", RAW, ids=lambda argv: ascii(argv)[1:40])
def test_bad_input_of_a_process(argv, work):
    """In a real process, with bytes that are not UTF-8."""
    before = tree(work)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "train.ppo", *argv]
    ended = subprocess.run(command, capture_output=True, timeout=60, check=False, env=environment)
    assert (ended.returncode, ended.stdout) == (2, b"")
    check_line(ended.stderr.decode("ascii").removesuffix("\n"), "python -m train.ppo: ")
    assert tree(work) == before


def test_more_than_two_thousand_bad_inputs(work):
    count = sum(len(overrides_of(name)) for name in NUMBERS)
    count += sum(len(sizes_of(name)) for name in SIZES)
    count += sum(len(leaves_of(name)) for name in LEAVES)
    count += sum(len(settings_of(name)) for name in FIELDS)
    count += len(structures()) + len(arguments()) + len(TOGETHER) + sum(map(len, FILES.values()))
    for name in COMMANDS:
        count += len(bad_lines(name, options_of(name)))
    assert count >= 2000
