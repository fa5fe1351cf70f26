"""Whole runs of the command on a probe: files, resuming, interruption."""

import dataclasses
import json
import os
import signal

import jax
import numpy as np
import pytest
import yaml

from medjax.policies.saved import load_policy
from tests.train.conftest import TINY, refused
from train import evaluate, export, ppo
from train.algorithms.programs import make_train, shapes_of
from train.runs.checkpoint import Checkpoints
from train.runs.logs import Progress, read_rows

CLOCK = ("wall_s", "env_steps_per_s")


def rows_of(run_dir):
    return [
        {name: value for name, value in row.items() if name not in CLOCK}
        for row in read_rows(run_dir / "metrics.jsonl")
    ]


def state_of(run_dir):
    from train.algorithms.environments import make_environment
    from train.runs.run_directory import RunDir

    # This process need not have the devices that the run had.
    config = dataclasses.replace(RunDir(run_dir).load_config(), num_devices=0)
    env, params = make_environment(config)
    shapes = shapes_of(make_train(env, params, config), params, config)
    return jax.tree.leaves(Checkpoints(run_dir).restore(shapes))


def assert_same_run(one, other):
    assert rows_of(one) == rows_of(other)
    for mine, theirs in zip(state_of(one), state_of(other), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.fixture
def interrupt_after(monkeypatch):
    """Sends SIGINT to this process once so many updates are shown."""

    def arrange(updates):
        show = Progress.show

        def show_and_interrupt(self, rows):
            show(self, rows)
            if rows[-1]["update"] == updates:
                os.kill(os.getpid(), signal.SIGINT)

        monkeypatch.setattr(Progress, "show", show_and_interrupt)
        return lambda: monkeypatch.setattr(Progress, "show", show)

    return arrange


@pytest.mark.versions
def test_a_run_leaves_what_is_promised(probe, capsys):
    assert ppo.main(TINY) == 0
    out, err = capsys.readouterr()
    run = probe / "runs" / "noisy-1"
    rows = read_rows(run / "metrics.jsonl")
    assert [row["update"] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [row["env_steps"] for row in rows] == [16, 32, 48, 64, 80, 96]
    summary = json.loads((run / "summary.json").read_text())
    assert summary["env_steps"] == 96
    assert summary["wall_s"] > summary["compile_s"] > 0
    assert summary["env_steps_per_s"] > 0
    assert summary["final_return_mean"] is not None
    assert json.loads((run / "config.json").read_text())["config"]["num_envs"] == 4
    assert (run / "plots" / "training_curve.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in (run / "checkpoints").iterdir()) == [
        "2.npz",
        "4.npz",
        "6.npz",
    ]
    assert load_policy(run / "policy.zip").about.scenario == "noisy"
    events = b"".join(path.read_bytes() for path in (run / "tensorboard").iterdir())
    for tag in (b"episode/return", b"episode/total", b"train/loss", b"train/episodes"):
        assert tag in events
    assert b"episode_" not in events  # once is enough
    for name in ("ppo", "none", "random"):
        assert name in out
    assert "\r" not in err  # no bar where stderr is no terminal
    # The next run takes the next number and leaves this one alone.
    before = (run / "metrics.jsonl").read_bytes()
    assert ppo.main([*TINY, "--seed=1", "--eval-episodes=0", "--keep-checkpoints=1"]) == 0
    other = probe / "runs" / "noisy-2"
    assert [path.name for path in (other / "checkpoints").iterdir()] == ["6.npz"]
    assert (run / "metrics.jsonl").read_bytes() == before
    assert rows_of(other) != rows_of(run)


def test_the_same_seed_gives_the_same_run_however_it_is_driven(probe, capsys, monkeypatch):
    """Other chunks, checkpoints, evaluation, or begun anew where it was killed before its first checkpoint."""
    assert ppo.main([*TINY, "--run-dir=whole", "--eval-episodes=0"]) == 0
    other = ["--updates-per-call=3", "--checkpoint-interval=0", "--keep-checkpoints=1"]
    monkeypatch.setattr(
        "train.runs.session.SECONDS_PER_CALL", 1e9
    )  # as many updates as may be at once
    assert ppo.main([*TINY, *other, "--run-dir=other"]) == 0
    assert_same_run(probe / "whole", probe / "other")
    (probe / "again").mkdir()
    (probe / "again" / "config.json").write_bytes((probe / "whole" / "config.json").read_bytes())
    capsys.readouterr()
    refused(capsys, ["--run-dir=again"], "holds no checkpoint", command=evaluate)
    assert ppo.main(["--resume=again"]) == 0
    assert_same_run(probe / "whole", probe / "again")


@pytest.mark.parametrize("ending", ["json", "yaml"])
def test_the_settings_of_a_run_repeat_it(probe, ending):
    """From its own file, and from one that somebody wrote; an option on the command line comes first."""
    assert ppo.main([*TINY, "--seed=7", "--set", "episode_decisions=7", "--run-dir=one"]) == 0
    saved = json.loads((probe / "one" / "config.json").read_text())
    if ending == "yaml":
        settings = {name: value for name, value in saved["config"].items() if name != "seed"}
        (probe / "mine.yaml").write_text(yaml.safe_dump(settings))
        argv = ["--config=mine.yaml", "--seed=7"]
    else:
        argv = ["--config=one/config.json"]
    assert ppo.main([*argv, "--run-dir=two"]) == 0
    assert_same_run(probe / "one", probe / "two")
    again = json.loads((probe / "two" / "config.json").read_text())
    assert again["config"] == saved["config"]


@pytest.mark.parametrize("seeds", [1, 2])
def test_interrupted_and_resumed_equals_uninterrupted_bit_for_bit(
    probe, capsys, interrupt_after, seeds
):
    options = [*TINY, f"--num-seeds={seeds}", "--eval-episodes=0", "--updates-per-call=1"]
    assert ppo.main([*options, "--run-dir=whole"]) == 0
    restore = interrupt_after(3)
    handler = signal.getsignal(signal.SIGINT)
    assert ppo.main([*options, "--run-dir=parts"]) == 130
    restore()
    assert signal.getsignal(signal.SIGINT) is handler
    assert "--resume parts" in capsys.readouterr().err
    assert len(rows_of(probe / "parts")) == 3
    assert (probe / "parts" / "summary.json").exists()
    assert ppo.main(["--resume=parts"]) == 0
    assert_same_run(probe / "whole", probe / "parts")
    summaries = [
        json.loads((probe / name / "summary.json").read_text()) for name in ("whole", "parts")
    ]
    for name in ("env_steps", "final_return_mean", "updates"):
        assert summaries[0][name] == summaries[1][name]


def test_interrupted_in_the_last_update(probe, capsys, interrupt_after):
    """What is left is to evaluate; the evaluation that is there is of other weights. Fewer devices export it, too."""
    assert ppo.main([*TINY, "--run-dir=run"]) == 0
    run = probe / "run"
    assert (run / "evaluation.json").exists()
    restore = interrupt_after(8)
    assert ppo.main(["--resume=run", "--total-timesteps=128", "--updates-per-call=1"]) == 130
    restore()
    assert capsys.readouterr().err.endswith("with: python -m train.evaluate --run-dir run\n")
    assert not (run / "evaluation.json").exists()
    settings = (run / "config.json").read_text()
    (run / "config.json").write_text(settings.replace('"num_devices": 0', '"num_devices": 64'))
    assert export.main(["--run-dir=run"]) == 0


def test_a_killed_run_goes_on_from_its_checkpoint(probe, monkeypatch):
    options = [*TINY, "--eval-episodes=0", "--updates-per-call=1"]
    assert ppo.main([*options, "--run-dir=whole"]) == 0
    show = Progress.show

    def die(self, rows):
        show(self, rows)
        if rows[-1]["update"] == 5:
            raise RuntimeError("killed")

    monkeypatch.setattr(Progress, "show", die)
    with pytest.raises(RuntimeError, match="killed"):
        ppo.main([*options, "--run-dir=parts"])
    monkeypatch.setattr(Progress, "show", show)
    assert len(rows_of(probe / "parts")) == 5  # one more than the checkpoint of update 4
    with (probe / "parts" / "metrics.jsonl").open("a") as file:
        file.write('{"update": 6, "env_st')  # cut off in the writing
    assert ppo.main(["--resume=parts"]) == 0
    assert_same_run(probe / "whole", probe / "parts")


def test_resume_refuses_what_does_not_fit(probe, capsys):
    assert ppo.main([*TINY, "--run-dir=run", "--eval-episodes=0"]) == 0
    capsys.readouterr()
    before = {path: path.read_bytes() for path in (probe / "run").rglob("*") if path.is_file()}
    refused(capsys, ["--resume=run"], "96 decisions", "--total-timesteps above 96")
    more = ["--resume=run", "--total-timesteps=1000"]
    for change, words in (
        (["--num-envs=8"], "num_envs 8, which was 4: checkpoint"),
        (["--hidden", "8"], "hidden (8,), which was (4,): checkpoint"),
        (["--num-seeds=2"], "num_seeds 2, which was 1: checkpoint"),
    ):
        refused(capsys, [*more, *change], words, "of another shape", "allowed: (")
    # What would fit, and have what was done counted in other updates than it was done in.
    for change, words in (
        ("--rollout-length=2", "rollout_length 2, which was 4 until now, allowed: 4"),
        ("--decide-every=2", "decide_every 2, which was 1 until now, allowed: 1"),
        ("--num-epochs=1", "num_epochs 1, which was 2 until now, allowed: 2"),
        ("--num-minibatches=1", "num_minibatches 1, which was 2 until now, allowed: 2"),
    ):
        refused(capsys, [*more, change], words)
    refused(capsys, [*TINY, "--run-dir=run"], "already holds files")
    assert before == {
        path: path.read_bytes() for path in (probe / "run").rglob("*") if path.is_file()
    }
    assert ppo.main(["--resume=run", "--total-timesteps=128"]) == 0
    assert len(rows_of(probe / "run")) == 8
    assert (probe / "run" / "config-until-6.json").exists()


@pytest.mark.parametrize(
    "place", ["runs.session.Session._compile", "runs.open_session.make_train", "evaluate"]
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_before_the_first_update(probe, capsys, monkeypatch, place, number):
    """While something is imported, traced, compiled or evaluated: one line, and nothing is left."""

    def interrupted(*_, **__):
        signal.raise_signal(number)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        if place == "evaluate":
            monkeypatch.setattr(evaluate, "whole_numbers", interrupted)
            code = evaluate.main(["--run-dir=run"])
        else:
            monkeypatch.setattr(f"train.{place}", interrupted)
            code = ppo.main([*TINY, "--run-dir=run"])
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == 128 + number
    err = capsys.readouterr().err
    assert err.startswith("interrupted")
    assert err.count("\n") == 1
    assert not (probe / "run").exists()


def test_evaluate_command(probe, capsys):
    options = [*TINY, "--num-seeds=2", "--eval-episodes=0", "--run-dir=run"]
    assert ppo.main(options) == 0
    argv = ["--run-dir=run", "--episodes=5", "--batch=2", "--json=out.json"]
    assert evaluate.main(argv) == 0
    result = json.loads((probe / "out.json").read_text())
    assert result["episodes"] == 5
    assert result["scenario"] == "noisy"
    assert set(result["policies"]) == {"ppo", "ppo_seed2", "start", "none", "random"}
    entry = result["policies"]["ppo"]
    low, high = entry["return_ci95"]
    assert low <= entry["return_mean"] <= high
    assert entry["decisions"] == 5.0
    assert set(result["paired_return_difference"]) == {"start", "none", "random"}
    assert len(result["training_seeds"]["return_means"]) == 2
    assert (result["overrides"], result["seed"]) == ({}, 0)
    some = ["--policies=ppo,random", "--baseline=none", "--set", "episode_decisions=3"]
    assert evaluate.main([*argv, *some]) == 0
    some = json.loads((probe / "out.json").read_text())
    assert set(some["policies"]) == {"ppo", "random", "none"}
    assert set(some["difference_from_baseline"]) == {"ppo", "random"}
    means = {name: entry["return_mean"] for name, entry in some["policies"].items()}
    gain = some["difference_from_baseline"]["random"]["mean"]
    assert gain == pytest.approx(means["random"] - means["none"])
    assert some["overrides"] == {"episode_decisions": 3}
    assert evaluate.main([*argv, "--stochastic", "--set", "episode_decisions=3", "--seed=4"]) == 0
    assert json.loads((probe / "out.json").read_text())["policies"]["none"]["decisions"] == 3.0
    assert "5 whole episodes of noisy" in capsys.readouterr().out
    # Without a run: a file, a rule, and what builds a policy, in the world of the file.
    several = "--policies=run/policy.zip,random,tests.train.conftest:coin"
    several = [several, "--set", "episode_decisions=3", "--episodes=5", "--json=out.json"]
    assert evaluate.main([*several, "--baseline=none"]) == 0
    without = json.loads((probe / "out.json").read_text())
    alike = without["policies"]["random"], without["policies"]["tests.train.conftest:coin"]
    assert alike[0] == alike[1]
    for name in ("none", "random"):
        assert without["policies"][name] == some["policies"][name]
    same = without["policies"]["run/policy.zip"]["return_mean"]
    assert same == pytest.approx(some["policies"]["ppo"]["return_mean"], rel=1e-6)
    assert (without["scenario"], without["overrides"]) == ("noisy", {"episode_decisions": 3})
    capsys.readouterr()
    refused(capsys, ["--episodes=3"], "neither --run-dir nor --policies", command=evaluate)
    for name in ("gone.zip", "tests.train.conftest:gone", "nowhere:act", "a:b:c", "best"):
        refused(capsys, [f"--policies=none,{name}"], f"policy '{name}'", command=evaluate)
    refused(capsys, [*argv, "--scenario=nowhere"], "nowhere", command=evaluate)
    refused(capsys, [*argv, "--set", "x=1"], "'x'", command=evaluate)
    for option in ("policies", "baseline"):
        said = "unknown policy 'all': allowed ppo, ppo_seed2, start, none, random, pretrained,"
        refused(capsys, [*argv, f"--{option}=all"], said, command=evaluate)
