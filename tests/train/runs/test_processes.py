"""Several devices and several processes train as one device does, and go on from one another's checkpoints."""

import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.train.conftest import TINY, refused
from tests.train.runs.test_session import rows_of, state_of
from train import ppo
from train.runs.logs import read_rows

EIGHT = [*TINY, "--num-envs=8", "--total-timesteps=192", "--eval-episodes=0"]  # 6 updates


@pytest.fixture
def start(request, probe):
    """Starts train.ppo on a probe in a process of its own, with so many CPU devices."""
    begun = []

    def start(argv, devices=1, **variables):
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.train.probe_run", *argv],
            cwd=request.config.rootpath,
            env={**os.environ, "JAX_NUM_CPU_DEVICES": str(devices), **variables},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        begun.append(process)
        return process

    yield start
    for process in begun:
        process.kill()
        process.communicate()


def finished(process):
    """What a process printed that must end well."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out


def together(number):
    """Options of each of so many processes on this machine."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    common = [f"--coordinator=localhost:{port}", f"--num-processes={number}"]
    return [[*common, f"--process-id={index}"] for index in range(number)]


def wait_for(metrics, updates, process):
    """Until so many are written."""
    while len(read_rows(metrics)) < updates:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)


def assert_same_curve(one, other):
    """Every metric of every update of `one` to rounding: sums over samples are taken in another order."""
    for mine, theirs in zip(rows_of(one), rows_of(other), strict=False):
        assert mine.keys() == theirs.keys()
        for name, value in mine.items():
            if value is None:  # no episode ended
                assert theirs[name] is None
                continue
            np.testing.assert_allclose(theirs[name], value, rtol=1e-5, atol=1e-6, err_msg=name)
    assert len(rows_of(other)) >= len(rows_of(one)) == 6


@pytest.mark.thorough
def test_devices_and_processes_train_as_one_device(probe, start):
    """The same global batch on one device, on four, and in two processes of two devices each."""
    forced = {"XLA_FLAGS": "--xla_force_host_platform_device_count=4"}
    four = start([*EIGHT, "--num-devices=4", f"--run-dir={probe}/four"], -1, **forced)
    pair = [start([*EIGHT, f"--run-dir={probe}/two", *own], 2) for own in together(2)]
    assert ppo.main([*EIGHT, "--num-devices=1", "--run-dir=one"]) == 0
    finished(four)
    first, second = map(finished, pair)
    assert "in 2 processes" in first
    assert "training" not in second  # the first alone reports
    for other in ("four", "two"):
        assert_same_curve(probe / "one", probe / other)
        mine, theirs = state_of(probe / "one"), state_of(probe / other)
        assert mine.keys() == theirs.keys()
        for name, value in mine.items():
            np.testing.assert_allclose(theirs[name], value, rtol=1e-5, atol=1e-6, err_msg=name)
    assert sorted(path.stem for path in (probe / "two" / "checkpoints").iterdir()) == list("246")


@pytest.mark.slow
def test_two_processes_go_on_from_one_and_one_from_two(probe, start):
    """A signal to the second stops both at the same update, saved; the run ends on a single device."""
    # Half a run must not plan for its own end: neither its learning rate nor its sharpness.
    options = [*EIGHT, "--no-anneal", "--sharpening=1"]
    assert ppo.main([*options, "--num-devices=1", "--run-dir=whole"]) == 0
    assert ppo.main([*options, "--total-timesteps=96", "--run-dir=parts"]) == 0
    resumed = [f"--resume={probe}/parts", "--total-timesteps=1e6"]
    first, second = [start([*resumed, *own]) for own in together(2)]
    wait_for(probe / "parts" / "metrics.jsonl", 8, first)
    second.send_signal(signal.SIGTERM)
    _, err = first.communicate(timeout=120)
    second.communicate(timeout=120)
    assert first.returncode == second.returncode == 128 + signal.SIGTERM
    assert f"--resume {probe}/parts" in err
    done = len(rows_of(probe / "parts"))
    more = 32 * (done + 2)
    argv = ["--resume=parts", f"--total-timesteps={more}", "--num-devices=1"]
    assert ppo.main(argv) == 0
    assert [row["update"] for row in rows_of(probe / "parts")] == list(range(1, done + 3))
    assert_same_curve(probe / "whole", probe / "parts")


@pytest.mark.slow
def test_a_process_that_is_lost_ends_the_others(probe, start):
    """They end soon, with a message of JAX's runtime or of ours, and what was saved is whole."""
    options = [*EIGHT, "--total-timesteps=1e6", f"--run-dir={probe}/run"]
    first, second = [start([*options, *own]) for own in together(2)]
    wait_for(probe / "run" / "metrics.jsonl", 4, first)
    second.send_signal(signal.SIGKILL)
    first.communicate(timeout=120)
    assert first.returncode != 0
    assert state_of(probe / "run")


@pytest.mark.thorough
def test_a_refusal_by_one_ends_all(probe, start):
    """The first finds the directory in use; the second says where to look."""
    (probe / "run").mkdir()
    (probe / "run" / "notes.txt").write_text("precious")
    pair = [start([*EIGHT, f"--run-dir={probe}/run", *own]) for own in together(2)]
    errors = [process.communicate(timeout=120)[1] for process in pair]
    assert [process.returncode for process in pair] == [2, 2]
    assert "already holds files" in errors[0]
    assert "process 0 of 2 refused" in errors[1]
    assert os.listdir(probe / "run") == ["notes.txt"]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--coordinator=nowhere"], ["coordinator is 'nowhere'", "HOST:PORT"]),
        (["--coordinator=host:99999"], ["'host:99999'", "HOST:PORT"]),
        (["--coordinator=host:1234"], ["num_processes is None", "a whole number from 1"]),
        (
            ["--coordinator=host:1234", "--num-processes=2", "--process-id=2"],
            ["process_id is 2", "0 to 1"],
        ),
        (["--num-processes=2"], ["num_processes is 2", "--coordinator"]),
        (["--coordinator=auto", "--process-id=0"], ["process_id 0", "--coordinator"]),
        (["--num-devices=3"], ["num_devices is 3", "allowed: 0 to 2"]),
    ],
)
def test_processes_that_make_no_sense(probe, capsys, argv, words):
    refused(capsys, TINY + argv, *words)
    assert list(probe.iterdir()) == []


@pytest.mark.thorough
def test_resumed_on_another_number_of_devices(probe):
    """A run that changes halfway from two devices to one, or from one to two, equals the run on one."""
    # Half a run must not plan for its own end: neither its learning rate nor its sharpness.
    options = [*EIGHT, "--no-anneal", "--sharpening=1"]
    assert ppo.main([*options, "--num-devices=1", "--run-dir=whole"]) == 0
    for before, after in ((2, 1), (1, 2)):
        half = [*options, "--total-timesteps=96", f"--run-dir=begun-on-{before}"]
        assert ppo.main([*half, f"--num-devices={before}"]) == 0
        rest = [f"--resume=begun-on-{before}", "--total-timesteps=192"]
        assert ppo.main([*rest, f"--num-devices={after}"]) == 0
        assert_same_curve(probe / "whole", probe / f"begun-on-{before}")
