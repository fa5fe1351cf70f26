"""Commands on a full disk or with too little memory, and a run whose newest checkpoint is damaged."""

import contextlib
import os

import pytest

from tests.train.conftest import TINY, refused
from tests.train.runs.test_faults import small_disk
from tests.train.runs.test_session import assert_same_run
from train import evaluate, export, ppo
from train.algorithms.ppo.settings import PPOConfig
from train.reporting.figures import new_figure, save
from train.runs.arguments import parse_request
from train.runs.open_session import open_session

QUIET = [*TINY, "--eval-episodes=0", "--updates-per-call=1"]


@pytest.fixture
def full_disk(probe):
    """A directory `disk` without room."""
    disk = probe / "disk"
    with small_disk(disk):
        with contextlib.suppress(OSError), (disk / "full").open("wb", 0) as file:
            while True:
                file.write(bytes(4096))
        yield disk


@pytest.mark.thorough
def test_a_full_disk_ends_a_command_in_a_line(probe, full_disk, capsys, monkeypatch):
    """With exit code 1; earlier files stay, and no half file is left."""
    assert ppo.main([*QUIET, "--run-dir=run"]) == 0
    argv = ["--run-dir=run", "--episodes=3"]
    draw = lambda path, *_: save(new_figure(3, 2), path)  # noqa: E731, probes have no metrics
    monkeypatch.setattr("train.reporting.figures.plot_comparison", draw)
    for command, given in (
        (evaluate, [*argv, "--json=disk/out.json"]),
        (evaluate, [*argv, "--json=out.json", "--plot=disk/out.png"]),
        (export, ["--run-dir=run", "--out=disk/out.zip"]),
    ):
        capsys.readouterr()
        assert command.main(given) == 1
        out, err = capsys.readouterr()
        assert err.count("\n") == 1, err
        assert command is export or "whole episodes of noisy" in out  # the work is not lost
        assert f"cannot write {given[-1].partition('=')[2]}: No space left" in err
        assert os.listdir(full_disk) == ["full"]
    assert (probe / "out.json").exists()
    with pytest.raises(OSError, match="No space left"):
        save(new_figure(3, 2), full_disk / "out.png")
    assert os.listdir(full_disk) == ["full"]


def test_evaluate_refuses_options_that_conflict(probe, capsys):
    for argv, words in (
        (["--run-dir=run", "--json=a.png", "--plot=a.png"], "both a.png"),
        (["--policies=none", "--stochastic"], "without --run-dir"),
    ):
        assert words in refused(capsys, argv, command=evaluate)


@pytest.mark.thorough
def test_what_exceeds_the_memory_is_refused_before_compiling(probe, capsys, monkeypatch):
    """A run and an evaluation; --force starts them all the same."""
    small = lambda: 20_000  # noqa: E731
    monkeypatch.setattr("medjax.numerics.memory.memory_bytes", small)
    compiled = []
    with monkeypatch.context() as patch:
        patch.setattr("train.runs.session.compiled", compiled.append)
        words = ("num_envs 4096 x 4 choices", "of memory, allowed: 2e-05 GB", "--force")
        refused(capsys, [*QUIET, "--num-envs=4096", "--run-dir=run"], *words)
        many = ["--eval-episodes=1000000", "--run-dir=run"]
        refused(capsys, [*QUIET, *many], "eval_episodes 1000000: about 3 GB", "--force")
    assert not compiled
    assert not (probe / "run").exists()
    assert ppo.main([*QUIET, "--run-dir=run", "--num-envs=4096", "--force"]) == 0
    capsys.readouterr()
    # It was for that command: whoever goes on with the run, or repeats it, is warned again.
    more = "--total-timesteps=1000000"
    for argv in (["--resume=run", more], ["--config=run/config.json", "--run-dir=new"]):
        refused(capsys, argv, "num_envs 4096 x 4 choices", "--force")
    argv = ["--run-dir=run", "--episodes=1000"]
    refused(capsys, argv, "--episodes 1000: about 0.003 GB", "--force", command=evaluate)
    assert evaluate.main([*argv, "--force"]) == 0


@pytest.mark.thorough
def test_a_run_resumes_before_a_damaged_checkpoint(probe, capsys):
    """With the options that the refusal names; the run ends as if it had never got further."""
    assert (
        ppo.main([*QUIET, "--run-dir=run", "--total-timesteps=80", "--no-anneal", "--sharpening=1"])
        == 0
    )
    assert ppo.main([*QUIET, "--run-dir=same", "--no-anneal", "--sharpening=1"]) == 0
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
    results = [probe / "run" / name for name in ("policy.zip", "evaluation.json", "summary.json")]
    results[1].write_text("{}")
    assert all(path.exists() for path in results)
    request = parse_request(PPOConfig, [*more, "--from-update=4"])
    open_session(request).lock.close()
    assert not any(path.exists() for path in results)  # they were of the weights that were removed
    assert ppo.main([*more, "--from-update=4"]) == 0
    assert_same_run(probe / "same", probe / "run")
