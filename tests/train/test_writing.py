"""What commands say where they cannot write, and go on from what can still be read."""

import contextlib
import os

import pytest

from tests.train.conftest import TINY, refused
from tests.train.runs.test_faults import small_disk
from tests.train.runs.test_session import assert_same_run
from train import evaluate, export, ppo
from train.reporting.figures import new_figure, save

QUIET = [*TINY, "--eval-episodes=0", "--updates-per-call=1"]


def fill(disk):
    """Leaves no room."""
    with contextlib.suppress(OSError), (disk / "full").open("wb", 0) as file:
        while True:
            file.write(bytes(4096))


def test_a_full_disk_ends_a_command_in_a_line(probe, capsys):
    """With exit code 1; what was there stays, and nothing half lies beside it."""
    assert ppo.main([*QUIET, "--run-dir=run"]) == 0
    with small_disk(probe / "disk"):
        fill(probe / "disk")
        for command, argv in (
            (evaluate, ["--run-dir=run", "--episodes=3", "--json=disk/out.json"]),
            (export, ["--run-dir=run", "--out=disk/out.zip"]),
        ):
            capsys.readouterr()
            assert command.main(argv) == 1
            err = capsys.readouterr().err
            assert err.count("\n") == 1, err
            assert "cannot write disk/out" in err
            assert "No space left" in err
            assert os.listdir(probe / "disk") == ["full"]
        figure = new_figure(3, 2)
        with pytest.raises(OSError, match="No space left"):
            save(figure, probe / "disk/out.png")
        assert os.listdir(probe / "disk") == ["full"]


def test_what_cannot_be_written_is_named(probe, capsys, monkeypatch):
    """The picture, where the numbers were written; one file cannot be both, and nothing is sampled without a run."""
    assert ppo.main([*QUIET, "--run-dir=run"]) == 0
    argv = ["--run-dir=run", "--episodes=3"]
    capsys.readouterr()
    refused(capsys, [*argv, "--json=a.png", "--plot=a.png"], "both a.png", command=evaluate)
    refused(capsys, ["--policies=none", "--stochastic"], "without --run-dir", command=evaluate)
    draw = lambda path, *_: save(new_figure(3, 2), path)  # noqa: E731, probes have no metrics
    monkeypatch.setattr("train.reporting.figures.plot_comparison", draw)
    with small_disk(probe / "disk"):
        fill(probe / "disk")
        assert evaluate.main([*argv, "--json=out.json", "--plot=disk/out.png"]) == 1
    assert "cannot write disk/out.png: No space left" in capsys.readouterr().err
    assert (probe / "out.json").exists()


def test_what_is_too_large_is_refused_before_it_is_compiled(probe, capsys, monkeypatch):
    """By what a run and an evaluation take of this machine; --force begins all the same."""
    small = lambda: 20_000  # noqa: E731
    monkeypatch.setattr("medjax.numerics.memory.memory_bytes", small)
    compiled = []
    with monkeypatch.context() as patch:
        patch.setattr("train.runs.session.compiled", compiled.append)
        words = ("num_envs 4096 x 4 choices", "of memory, allowed: 2e-05 GB", "--force")
        refused(capsys, [*QUIET, "--num-envs=4096", "--run-dir=run"], *words)
        many = ["--eval-episodes=1000000", "--run-dir=run"]
        refused(capsys, [*QUIET, *many], "eval_episodes 1000000: about 2 GB", "--force")
    assert not compiled
    assert not (probe / "run").exists()
    assert ppo.main([*QUIET, "--run-dir=run", "--num-envs=4096", "--force"]) == 0
    capsys.readouterr()
    argv = ["--run-dir=run", "--episodes=1000"]
    refused(capsys, argv, "--episodes 1000: about 0.002 GB", "--force", command=evaluate)
    assert evaluate.main([*argv, "--force"]) == 0


def test_the_checkpoint_before_a_damaged_one_is_gone_on_from(probe, capsys):
    """As the refusal says; the run ends as if it had never come further."""
    assert ppo.main([*QUIET, "--run-dir=run", "--total-timesteps=80", "--no-anneal"]) == 0
    assert ppo.main([*QUIET, "--run-dir=same", "--no-anneal"]) == 0
    newest = probe / "run/checkpoints/5.npz"
    newest.write_bytes(newest.read_bytes()[:100])
    capsys.readouterr()
    more = ["--resume=run", "--total-timesteps=96"]
    assert "--resume run --from-update 4" in refused(capsys, more, "5.npz is damaged")
    refused(
        capsys, [*more, "--from-update=3"], "no checkpoint of update 3 is there, allowed: 2, 4, 5"
    )
    refused(capsys, [*QUIET, "--from-update=4"], "--from-update without --resume")
    assert newest.exists()
    assert ppo.main([*more, "--from-update=4"]) == 0
    assert_same_run(probe / "same", probe / "run")
