"""Bad input, 2000 times and more: one clear line, exit code 2, nothing made and nothing compiled; good input passes."""

import contextlib
import dataclasses
import importlib
import math
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest

import medjax
import train.session  # noqa: F401 - takes seconds, which count for no input
from medjax import commandline
from medjax import config as world
from medjax.ranges import SIZES
from medjax.scenarios import prepare
from medjax.wording import InputError
from tests import fuzz
from train import cli
from train.config import TrainConfig

MOST_S = 2.0  # of the processor: nothing here waits
MOST_CHARACTERS = 400  # of a message: the value, the name and what is allowed
COMPILED = "/jax/core/compile/backend_compile_duration"
ROWS = {row.name: row for row in [*fuzz.ROWS, *fuzz.COILS]}


class AcceptedError(BaseException):
    """Bad input got as far as the first program."""


@pytest.fixture(autouse=True)
def nothing_starts(monkeypatch):
    """No test here compiles; the first program of every command is the coils' table."""
    compiled = []

    def listen(event, duration, **_):
        if event == COMPILED:
            compiled.append(duration)

    def accepted(*_, **__):
        raise AcceptedError

    monkeypatch.setattr("medjax.scenarios.build_link", accepted)
    jax.monitoring.register_event_duration_secs_listener(listen)
    yield
    jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled


def check_line(line, *words):
    """One short line that a terminal can show and that has the words."""
    assert line.isprintable(), ascii(line)
    assert len(line) <= MOST_CHARACTERS, len(line)
    for word in words:
        assert word in line, line


def refused(call, *words):
    """The message of the ValueError that a call ends with, at once and without a warning."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=r"allowed|did you mean") as error:
            call()
    assert time.process_time() - start < MOST_S
    assert type(error.value) in (ValueError, InputError)
    check_line(str(error.value), *words)


def each(calls, *words):
    """Refuses all; what was not is told together."""
    wrong = []
    for value, call in calls:
        try:
            refused(call, *words)
        except (AcceptedError, pytest.fail.Exception, AssertionError, Exception) as error:
            kind = type(error).__name__
            wrong.append(f"{type(value).__name__} {ascii_of(value)}: {kind} {str(error)[:200]}")
    assert not wrong, "\n".join(wrong)
    return len(calls)


def ascii_of(value):
    try:
        return ascii(value)[:60]
    except Exception:
        return "?"


# The environment: by name, by size, and by leaf.


def overrides_of(name):
    return [
        (value, lambda value=value: medjax.make(**{name: value}))
        for value in fuzz.bad_values(ROWS[name])
    ]


@pytest.mark.parametrize("name", ROWS)
def test_bad_overrides(name):
    """As an argument of make: number, size, coil or weight."""
    short = name.rpartition(".")[2]
    # A list of places says how many ramps there are, and may be refused for that.
    each(overrides_of(name), "ramp" if short == "ramp_x_m" else short)


def sizes_of(name):
    return [(v, lambda v=v: medjax.EnvConfig(**{name: v})) for v in fuzz.bad_values(ROWS[name])]


@pytest.mark.parametrize("name", SIZES)
def test_bad_sizes(name):
    each(sizes_of(name), name)


def leaves_of(name):
    env, params, _ = prepare()
    group, _, leaf = name.rpartition(".")

    def changed(value):
        if not group:
            return params.replace(**{leaf: value})
        holder = getattr(params, group)
        if group == "reward_weights":
            return params.replace(reward_weights={**holder, leaf: value})
        return params.replace(**{group: holder.replace(**{leaf: value})})

    return [
        (v, lambda v=v: world.validate(env.config, changed(v))) for v in fuzz.bad_values(ROWS[name])
    ]


LEAVES = [row.name for row in fuzz.ROWS if row.name not in SIZES]


@pytest.mark.parametrize("name", LEAVES)
def test_bad_leaves(name):
    """As a leaf of params, which `validate` checks."""
    each(leaves_of(name), name)


def structures():
    env, params, _ = prepare()
    wrong = (None, 3, "x", {}, [], params.road.length_m, params)
    calls = []
    for group in ("road", "drivers", "fleet", "link", "reward_weights"):
        calls += [
            (
                value,
                lambda group=group, value=value: world.validate(
                    env.config, params.replace(**{group: value})
                ),
            )
            for value in (*wrong[:3], wrong[4], params)
        ]
    calls += [(v, lambda v=v: world.validate(env.config, v)) for v in wrong[:6]]
    calls += [(v, lambda v=v: world.validate(v, params)) for v in wrong]
    calls += [(v, lambda v=v: medjax.ChargingEnv(v)) for v in wrong]
    link = params.link
    calls += [
        (v, lambda v=v: world.validate(env.config, params.replace(link=link.replace(inductance=v))))
        for v in (None, 3, np.zeros((2, 4, 4)))
    ]
    table = fake_table()
    for name in vars(table):
        for value in (None, "x", math.nan, np.zeros((2, 4)), np.full((2, 4, 4), np.nan)):
            broken = link.replace(inductance=table.replace(**{name: value}))
            calls.append(
                (
                    value,
                    lambda broken=broken: world.validate(env.config, params.replace(link=broken)),
                )
            )
    return calls


def fake_table():
    one = np.float32(1)
    return world.InductanceTable(np.zeros((2, 4, 4), np.float32), one, one, one, one, one)


def test_bad_structures():
    each(structures())


def arguments():
    names = [v for v in fuzz.NO_NUMBERS if not isinstance(v, str)]
    names += ["", "papre", "PAPER", "paper ", "paper\n", "\ud800", "p" * 100_000, 3, 0.5]
    calls = [(v, lambda v=v: medjax.make(v)) for v in names]
    calls += [(v, lambda v=v: medjax.make(observation=v)) for v in names if not callable(v)]
    calls += [
        (v, lambda v=v: medjax.make(reward=v))
        for v in names
        if v is not None and not isinstance(v, dict)
    ]
    calls += [
        (v, lambda v=v: medjax.make(reward_weights=v)) for v in names if not isinstance(v, dict)
    ]
    calls += [(v, lambda v=v: medjax.make(reward={v: max})) for v in (None, 3, b"x", ())]
    calls += [(v, lambda v=v: medjax.make(reward={"mine": v})) for v in (None, 3, "x", [])]
    keys = (
        "",
        " ",
        "cooldown",
        "cooldown_s ",
        "COOLDOWN_S",
        "mass_kg",
        "ev",
        "ev.",
        ".mass_kg",
        "ev.mass_kg.x",
        "link.inductance",
        "inductance",
        "road",
        "reward_weights.",
        "reward_weights.x",
        "__class__",
        "params",
        "config",
        "\n",
        "\ud800",
        "n" * 100_000,
        "٣",
        "road.cooldown_s",
        "drivers.KINDS",
        "-rf",
        "fleet.size=3",
    )
    calls += [(v, lambda v=v: medjax.make(**{v: 1.0})) for v in keys]
    return calls


def test_bad_arguments():
    """Names, observations and rewards."""
    each(arguments())


TOGETHER = [
    ({"cooldown_s": 1.0, "fleet.cooldown_s": 1.0}, "cooldown_s"),
    ({"length_m": 3000}, "ramp_x_m"),
    ({"length_m": 3449}, "ramp_x_m"),
    ({"acceleration_lane_m": 801}, "ramp_x_m"),
    ({"acceleration_lane_m": 22}, "acceleration_lane_m"),
    ({"ramp_speed": 60, "max_braking": 7}, "acceleration_lane_m"),
    ({"ramp_x_m": [1200, 100, 2100, 3200]}, "ramp_x_m"),
    ({"ramp_x_m": [100] * 9}, "num_ramps"),
    ({"ramp_x_m": np.zeros(100)}, "num_ramps"),
    ({"ramp_x_m": [100, 1200], "num_ramps": 3}, "ramp_x_m"),
    ({"num_ramps": 3, "ramp_per_h": [1, 2, 3, 4]}, "ramp_per_h"),
    ({"desired_speed": [30, 30, 30]}, "desired_speed"),
    ({"arrival_soc_low": 0.71}, "arrival_soc_low"),
    ({"request_soc": 0.81}, "request_soc"),
    ({"size": 16}, "size"),
    ({"num_meds": 3, "size": 4}, "size"),
    ({"num_lanes": 3, "service_lane": 3}, "service_lane"),
    ({"num_evs": 4096, "num_gas": 4096, "num_lanes": 6}, "num_gas"),
]


@pytest.mark.parametrize(("overrides", "name"), TOGETHER)
def test_bad_combinations(overrides, name):
    """Each is in its range; together they are not."""
    refused(lambda: medjax.make(**overrides), name)


# The learner's settings.

FIELDS = {field.name: field for field in dataclasses.fields(TrainConfig)}


def settings_of(name):
    field = FIELDS[name]
    one = field.default[0] if isinstance(field.default, tuple) else field.default
    bad = [v for v in fuzz.NO_NUMBERS if not isinstance(v, list | np.ndarray | jax.Array)]
    bad += [fuzz.DEEP, fuzz.HEAVY]
    if name == "overrides":
        bad = [v for v in bad if v is not None and v != {} and not isinstance(v, dict)]
        inner = [v for v in fuzz.NO_NUMBERS if not isinstance(v, bool | str | list | dict)]
        bad += [{"cooldown_s": v} for v in inner] + [
            {v: 1} for v in (None, 3, "", "name", "reward")
        ]
    elif isinstance(one, str):
        bad = [v for v in bad if not isinstance(v, str)] + [3, 0.5]
        bad += ["tahn", "", "\ud800"] if field.metadata["choices"] else []
    elif isinstance(one, bool):
        bad = [v for v in bad if not isinstance(v, bool)] + [0, 1, 0.0, np.bool_(True)]
    else:
        low, high = field.metadata["low"], field.metadata["high"]
        assert math.isfinite(low)
        assert math.isfinite(high)
        whole = isinstance(one, int)
        bad += [v for v in fuzz.outside(low, high, whole) if not isinstance(v, list | jax.Array)]
        if whole:
            bad += [2.0, np.float32(low), "1"]
    if isinstance(field.default, tuple):
        bad = [[value] for value in bad] + [[], (), None, 3, "12", {1: 2}, [1] * 100_000]
    return [(v, lambda v=v: TrainConfig(**{name: v})) for v in bad]


@pytest.mark.parametrize("name", FIELDS)
def test_bad_settings(name):
    each(settings_of(name), "" if name == "overrides" else name)


FILES = fuzz.FILES


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A working directory with what `fuzz.PATHS` names."""
    (tmp_path / "work/used").mkdir(parents=True)
    work = tmp_path / "work"
    (work / "used/notes.txt").write_text("precious")
    (work / "file").write_text("precious")
    (work / "loop").symlink_to("loop")
    (work / "dangling").symlink_to("nowhere")
    (work / "run").mkdir()
    (work / "run/config.json").write_text("{}")
    (work / "policy").mkdir()
    (work / "policy/policy.zip").write_text("no zip")
    monkeypatch.chdir(work)
    return work


def tree(root):
    return sorted((str(path), path.lstat().st_size) for path in root.rglob("*"))


def ended(main, argv):
    """Exit code of a command."""
    try:
        return main(argv)
    except SystemExit as end:
        return end.code


def refused_by(name, argvs, work, capsys, *words):
    """Refuses all command lines of a command, and leaves the working directory as it is."""
    main = importlib.import_module(name).main
    before, wrong = tree(work), []
    for argv in argvs:
        start, code = time.process_time(), None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                code = ended(main, argv)
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
    assert not wrong, f"{len(wrong)} of {len(argvs)}\n" + "\n".join(wrong)


@pytest.mark.parametrize("name", FILES)
def test_bad_files(name, work, capsys):
    for text in [*(text.encode() for text in FILES[name]), b"\xff\xfe\x80"]:
        Path(name).write_bytes(text)
        refused_by("train.ppo", [[f"--config={name}", "--run-dir=new"]], work, capsys, name)


# The command lines.

COMMANDS = {
    "train.ppo": [],
    "train.evaluate": ["--run-dir=run"],
    "train.report": ["--run-dir=run"],
    "train.export": ["--run-dir=run"],
    "medjax.render.__main__": ["--out=new.png"],
    "medjax.trajectories": ["--out=new.csv"],
    "benchmarks.calibrate": [],
    "benchmarks.generalization": ["--run-dir=run"],
    "benchmarks.kernels": [],
    "benchmarks.peers.__main__": [],
    "benchmarks.planner": [],
    "benchmarks.scaling": [],
    "benchmarks.throughput": [],
    "benchmarks.training": [],
    "benchmarks.tune": [],
    "benchmarks.ablation.__main__": ["cooldown"],
}
ALWAYS = (
    "--frobnicate",
    "--frobnicate=1",
    "-x",
    "positional",
    "-",
    "--=",
    "--\ud800",
    "--seed=1=2",
    "\n",
    "x" * 100_000,
)
FILE_OPTIONS = ("json", "plot", "out")
DIRECTORY_OPTIONS = ("run_dir", "resume", "config")


def options_of(name, monkeypatch):
    """Options of a command by their place in its parser."""
    found = {}

    def stop(parser, args=None, namespace=None):
        found.update({action.dest: action for action in parser._actions if action.option_strings})
        raise AcceptedError

    for owner in (cli, commandline):
        monkeypatch.setattr(owner.OneLineParser, "parse_args", stop, raising=False)
    with contextlib.suppress(AcceptedError):
        importlib.import_module(name).main([])
    monkeypatch.undo()
    return found


def bad_lines(name, options):
    """Command lines, each with one thing wrong."""
    start = COMMANDS[name]
    lines = [[*start, word] for word in ALWAYS]
    for dest, action in options.items():
        flag = action.option_strings[0]
        if dest == "help":
            continue
        if action.nargs == 0:
            texts = ["", "x", "true"]
        elif dest in FILE_OPTIONS:
            texts = [
                text for text in fuzz.PATHS if text not in ("file", "file/", "loop", "dangling")
            ]
        elif dest in DIRECTORY_OPTIONS:
            texts = fuzz.PATHS
        else:
            texts = fuzz.TEXTS
            lines.append([*start, flag])
        if dest in DIRECTORY_OPTIONS and flag + "=run" in start:
            start = [word for word in start if not word.startswith(flag)]
        lines += [[*start, f"{flag}={text}"] for text in texts]
    return lines


@pytest.mark.parametrize("name", COMMANDS)
def test_bad_command_lines(name, work, capsys, monkeypatch):
    options = options_of(name, monkeypatch)
    monkeypatch.setattr("medjax.scenarios.build_link", _accepted)
    monkeypatch.chdir(work)
    refused_by(name, bad_lines(name, options), work, capsys)


def _accepted(*_, **__):
    raise AcceptedError


RAW = [
    ["--run-dir", b"\xff\xfe"],
    ["--run-dir", "a\nb"],
    ["--run-dir", "x" * 300],
    ["--run-dir", ""],
    ["--run-dir", "loop/run"],
    ["--set", b"cooldown_s=\xff"],
    ["--set=--"],
    [b"--\xff\x1b[2J"],
    ["--config", "/dev/zero"],
    ["--config", "loop"],
    ["--resume", "dangling"],
    ["--lr", "9" * 100_000],
]


@pytest.mark.parametrize("argv", RAW, ids=lambda argv: ascii(argv)[1:40])
def test_bad_input_of_a_process(argv, work):
    """The same for real, with bytes that are no text."""
    before = tree(work)
    environment = os.environ | {"PYTHONPATH": str(fuzz.ROOT)}
    command = [sys.executable, "-m", "train.ppo", *argv]
    ended = subprocess.run(command, capture_output=True, timeout=60, check=False, env=environment)
    assert (ended.returncode, ended.stdout) == (2, b"")
    check_line(ended.stderr.decode("ascii").removesuffix("\n"), "python -m train.ppo: ")
    assert tree(work) == before


def test_there_are_two_thousand(monkeypatch, work):
    """Bad inputs in all."""
    count = sum(len(overrides_of(name)) for name in ROWS)
    count += sum(len(sizes_of(name)) for name in SIZES)
    count += sum(len(leaves_of(name)) for name in LEAVES)
    count += sum(len(settings_of(name)) for name in FIELDS)
    count += len(structures()) + len(arguments()) + len(TOGETHER) + sum(map(len, FILES.values()))
    for name in COMMANDS:
        count += len(bad_lines(name, options_of(name, monkeypatch)))
    assert count >= 2000
