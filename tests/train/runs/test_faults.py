"""Faults during a run: one clear line, an exit code, and nothing saved before is lost."""

import contextlib
import json
import os
import pickle
import shutil
import signal
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.errors import InputError
from medjax.numerics import compilation
from tests.train.conftest import TINY, refused
from tests.train.probe_envs import Probe, ProbeParams
from tests.train.runs.conftest import QUIET
from tests.train.runs.test_session import assert_same_run, rows_of
from train import ppo
from train.algorithms.environments import make_environment
from train.algorithms.programs import make_train, shapes_of
from train.runs.checkpoint import Checkpoints
from train.runs.policies import load_weights
from train.runs.run_directory import RunDir, new_run_dir


@pytest.fixture(autouse=True)
def no_line_on_compiling(monkeypatch):
    """However slow the machine: stderr has only the fault's line."""
    monkeypatch.setattr(compilation, "SILENT_S", 3600.0)


def stopped(capsys, argv, *words, code=1):
    """The one line on stderr of a run that stops on its way."""
    assert ppo.main(argv) == code
    err = capsys.readouterr().err
    assert err.count("\n") == 1, err
    for word in words:
        assert word in err
    return err


class Breaks(Probe):
    """From the fourth update on its reward is NaN, its observation infinite, or the sum of its rewards overflows."""

    def step_env(self, key, state, action, params):
        obs, state, reward, terminated, truncated, info = super().step_env(
            key, state, action, params
        )
        late = state.time > 12
        if self.kind == "bad reward":
            reward = jnp.where(late, jnp.nan, reward)
        elif self.kind == "vast reward":
            reward = jnp.where(late, 3e38, reward)
        else:
            obs = jnp.where(late, jnp.inf, obs)
        return obs, state, reward, terminated, truncated, info


@pytest.mark.parametrize(
    ("kind", "named"),
    [("bad reward", "rewards"), ("vast reward", "advantages"), ("bad sight", "observations")],
)
def test_a_number_that_is_not_finite_is_named(probe, capsys, monkeypatch, kind, named):
    """In the update where it happens, the first in the order of computing; the checkpoint before it is kept."""
    monkeypatch.setattr(
        "medjax.make", lambda *args, **options: (Breaks(kind), ProbeParams(episode_decisions=40))
    )
    options = [*TINY, "--eval-episodes=0", "--no-stagger", "--no-normalize-rewards"]
    options.append("--run-dir=run")
    stopped(capsys, options, f"{named} no longer finite in update 4", "checkpoint is of update 2")
    assert [row["update"] for row in rows_of(probe / "run")] == [1, 2, 3, 4]
    assert sorted(path.name for path in (probe / "run" / "checkpoints").iterdir()) == ["2.npz"]


@contextlib.contextmanager
def small_disk(path, size="200k"):
    """A file system of its own; skips where this user may not make one."""
    path.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


@pytest.mark.thorough
def test_a_full_disk(probe, capsys):
    """The run stops in one line with whole files, and resumes bit for bit once there is room."""
    options = [*QUIET, "--total-timesteps=640", "--checkpoint-interval=1", "--keep-checkpoints=99"]
    assert ppo.main([*options, "--run-dir=whole"]) == 0
    capsys.readouterr()
    with small_disk(probe / "disk"):
        line = stopped(capsys, [*options, "--run-dir=disk/run"], "cannot write disk/run")
        assert "No space left" in line or "could not be written" in line
        run = probe / "disk" / "run"
        text = (run / "metrics.jsonl").read_text()
        assert text.endswith("\n")
        assert 0 < len(rows_of(run)) < 40
        json.loads((run / "config.json").read_text())
        shutil.copytree(run, probe / "more")
    assert ppo.main(["--resume=more"]) == 0
    assert_same_run(probe / "whole", probe / "more")


def test_a_removed_directory_is_not_made_again(probe, capsys, after_update):
    after_update(3, lambda: shutil.rmtree(probe / "run"))
    stopped(capsys, [*QUIET, "--run-dir=run"], "cannot write run", "No such file")
    assert list(probe.iterdir()) == []


@pytest.mark.thorough
def test_a_file_system_that_becomes_read_only(probe, whole, capsys, after_update):
    run = str(probe / "run")

    def remount():
        subprocess.run(["mount", "--bind", run, run], check=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", run], check=True)

    with small_disk(probe / "disk"):
        pass  # this user may mount
    after_update(3, remount)
    try:
        words = ("Read-only file system", "checkpoint is of update 2")
        stopped(capsys, [*QUIET, "--run-dir=run"], *words)
        refused(capsys, ["--resume=run"], "cannot write run-dir", "Read-only")
        refused(capsys, [*TINY, "--run-dir=run/other"], "cannot write run-dir", "Read-only")
    finally:
        subprocess.run(["umount", "-l", run], check=False)
    assert ppo.main(["--resume=run"]) == 0
    assert_same_run(whole, probe / "run")


def test_sigterm_saves(probe, whole, capsys, after_update):
    after_update(3, lambda: os.kill(os.getpid(), signal.SIGTERM))
    code = 128 + signal.SIGTERM
    stopped(capsys, [*QUIET, "--run-dir=run"], "after update 3, saved", "--resume run", code=code)
    assert Checkpoints(probe / "run").latest() == 3
    assert ppo.main(["--resume=run"]) == 0
    assert_same_run(whole, probe / "run")


def test_a_second_ctrl_c_ends_at_once(probe, whole, capsys, after_update, at_a_terminal):
    """Without a traceback; the run resumes from what was saved before."""

    def twice():
        for _ in range(2):  # to this thread: two that are sent to the process may count as one
            signal.raise_signal(signal.SIGINT)

    after_update(3, twice)
    stopped(capsys, [*QUIET, "--run-dir=run"], "at once", "checkpoint is of update 2", code=130)
    assert ppo.main(["--resume=run"]) == 0
    assert_same_run(whole, probe / "run")


def test_one_run_at_a_time_in_a_directory(probe, whole, capsys, after_update):
    """A second one is refused, started or resumed, and the first goes on."""

    def intrude():
        capsys.readouterr()
        refused(capsys, ["--resume=run"], "run run is under way in another process")
        refused(capsys, [*TINY, "--run-dir=run"], "run")

    after_update(3, intrude)
    assert ppo.main([*QUIET, "--run-dir=run"]) == 0
    assert_same_run(whole, probe / "run")
    RunDir(probe / "run").lock().close()  # it has ended, so that it can be locked
    capsys.readouterr()
    refused(capsys, ["--resume=run"], "has done its 96 decisions")


def test_runs_without_a_name_never_share_a_directory(probe):
    """Nor do several that look for a free number at once: `new_run_dir` makes the directory itself."""
    assert [new_run_dir("noisy").name for _ in range(3)] == ["noisy-1", "noisy-2", "noisy-3"]


@pytest.fixture
def saved(probe, whole):
    """The checkpoints of a run, and a function that reads the newest."""
    shutil.copytree(whole, probe / "run")
    config = RunDir(probe / "run").load_config()
    env, params = make_environment(config)
    shapes = shapes_of(make_train(env, params, config), params, config)

    def read():
        """All of the newest checkpoint as bytes, or why it is refused."""
        try:
            state = Checkpoints(probe / "run").restore(shapes)
        except InputError as error:
            return str(error)
        return [leaf.tobytes() for leaf in jax.tree.leaves(state)]

    return probe / "run" / "checkpoints", read


MORE = ["--resume=run", "--total-timesteps=128"]


def test_a_damaged_checkpoint_is_refused_in_a_line(saved, capsys):
    """A file with one changed bit, or cut off anywhere, is refused or read as it was."""
    place, read = saved
    path, intact = place / "6.npz", read()
    assert isinstance(intact, list)
    whole = path.read_bytes()
    refusals = []
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << rng.integers(8)
        for data in (bytes(damaged), whole[:position]):
            path.write_bytes(data)
            found = read()
            if found != intact:
                assert isinstance(found, str), position
                refusals.append(found)
    assert len(refusals) > 400
    for line in refusals:
        assert "checkpoints/6.npz is " in line
        assert "\n" not in line
    refused(capsys, MORE, "checkpoints/6.npz")


def test_a_foreign_checkpoint_is_refused_in_a_line(saved, capsys):
    """Another format, another program's archive, a pickle; a damaged older one does no harm."""
    place, read = saved
    with np.load(place / "6.npz") as file:
        arrays = dict(file)
    (place / "4.npz").write_bytes(b"")
    assert isinstance(read(), list)
    about = {**json.loads(str(arrays["about"])), "format": 1}
    np.savez(place / "6.npz", **arrays | {"about": json.dumps(about)})
    refused(capsys, MORE, "checkpoints/6.npz is of format 1, allowed: 3")
    about["format"] = 2
    np.savez(place / "6.npz", **arrays | {"about": json.dumps(about)})
    refused(capsys, MORE, "checkpoints/6.npz is of format 2, allowed: 3")
    np.savez(place / "6.npz", weights=np.ones(3))
    refused(capsys, MORE, "checkpoints/6.npz", "none of train.ppo")
    (place / "6.npz").write_bytes(pickle.dumps(Owned()))
    refused(capsys, MORE, "checkpoints/6.npz", "none of train.ppo")
    np.savez(place / "6.npz", **arrays | {"update": np.asarray(Owned(), object)})
    refused(capsys, MORE, "checkpoints/6.npz", "none of train.ppo")
    assert not Path("owned").exists()
    np.savez(place / "6.npz", **arrays)
    assert ppo.main(MORE) == 0


def test_weights_of_the_format_before_are_read_unsharpened(saved):
    """As they were played; they lack the factor of the logits, and their run cannot go on."""
    place, read = saved
    config = RunDir(place.parent).load_config()
    _, _, now = load_weights(place.parent, config)
    assert float(now.sharpness) == pytest.approx(1.04**6)
    with np.load(place / "6.npz") as file:
        arrays = {name: file[name] for name in file.files if name != "weights/sharpness"}
    about = {**json.loads(str(arrays["about"])), "format": 2}
    np.savez(place / "6.npz", **arrays | {"about": json.dumps(about)})
    _, _, before = load_weights(place.parent, config)
    assert float(before.sharpness) == 1.0
    for one, other in zip(jax.tree.leaves(before.params), jax.tree.leaves(now.params), strict=True):
        np.testing.assert_array_equal(one, other)
    assert "is of format 2, allowed: 3" in read()


class Owned:
    """Makes a file when it is unpickled."""

    def __reduce__(self):
        return Path.touch, (Path("owned"),)
