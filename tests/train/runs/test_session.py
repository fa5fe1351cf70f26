"""Whole runs of the command on a probe: files, resuming, interruption."""

import json
import os
import shutil
import signal

import numpy as np
import pytest
import yaml

from medjax.policies.rules import BASELINES
from medjax.policies.saved import load_policy
from tests.train.conftest import TINY, refused
from tests.train.runs.conftest import QUIET
from train import evaluate, export, ppo
from train.runs.checkpoint import Checkpoints
from train.runs.logs import read_rows

CLOCK = ("wall_s", "env_steps_per_s")


def rows_of(run_dir):
    return [
        {name: value for name, value in row.items() if name not in CLOCK}
        for row in read_rows(run_dir / "metrics.jsonl")
    ]


def state_of(run_dir):
    """Arrays of the newest checkpoint, by name."""
    directory = run_dir / "checkpoints"
    with np.load(directory / f"{Checkpoints(run_dir).latest()}.npz") as file:
        return {name: file[name] for name in file.files if name != "about"}


def assert_same_run(one, other):
    """Bit for bit."""
    assert rows_of(one) == rows_of(other)
    mine, theirs = state_of(one), state_of(other)
    assert mine.keys() == theirs.keys()
    for name, value in mine.items():
        np.testing.assert_array_equal(theirs[name], value, err_msg=name, strict=True)


def files_of(run_dir):
    return {path: path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_run(probe, whole, capsys, monkeypatch):
    """With other chunks, checkpoints and evaluation, and begun anew after a kill before its first checkpoint."""
    assert ppo.main([*TINY, "--run-dir=usual", "--eval-episodes=0"]) == 0
    assert_same_run(whole, probe / "usual")
    other = [*TINY, "--updates-per-call=3", "--checkpoint-interval=0", "--keep-checkpoints=1"]
    monkeypatch.setattr("train.runs.session.SECONDS_PER_CALL", 1e9)  # as many updates as allowed
    assert ppo.main([*other, "--run-dir=other"]) == 0
    assert_same_run(whole, probe / "other")
    (probe / "again").mkdir()
    shutil.copy(whole / "config.json", probe / "again")
    capsys.readouterr()
    refused(capsys, ["--run-dir=again"], "holds no checkpoint", command=evaluate)
    assert ppo.main(["--resume=again"]) == 0
    assert_same_run(whole, probe / "again")


@pytest.mark.thorough
def test_the_settings_of_a_run_repeat_it(probe):
    """From its own file, and from YAML that somebody wrote; options on the command line override both."""
    assert ppo.main([*QUIET, "--seed=7", "--set", "episode_decisions=7", "--run-dir=one"]) == 0
    saved = json.loads((probe / "one" / "config.json").read_text())["config"]
    (probe / "mine.yaml").write_text(yaml.safe_dump(saved | {"seed": 3}))
    for number, argv in enumerate(
        (["--config=one/config.json"], ["--config=mine.yaml", "--seed=7"])
    ):
        assert ppo.main([*argv, f"--run-dir={number}"]) == 0
        assert_same_run(probe / "one", probe / str(number))
        assert json.loads((probe / str(number) / "config.json").read_text())["config"] == saved


@pytest.mark.parametrize("seeds", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_interrupted_and_resumed_equals_uninterrupted(
    probe, capsys, after_update, at_a_terminal, seeds
):
    options = [*QUIET, f"--num-seeds={seeds}"]
    assert ppo.main([*options, "--run-dir=whole"]) == 0
    after_update(3, interrupt)
    assert ppo.main([*options, "--run-dir=parts"]) == 130
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert "--resume parts" in capsys.readouterr().err
    assert len(rows_of(probe / "parts")) == 3
    assert (probe / "parts" / "summary.json").exists()
    assert ppo.main(["--resume=parts"]) == 0
    assert_same_run(probe / "whole", probe / "parts")
    one, other = (
        json.loads((probe / name / "summary.json").read_text()) for name in ("whole", "parts")
    )
    for name in ("env_steps", "final_return_mean", "updates"):
        assert one[name] == other[name]


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_in_the_last_update(probe, capsys, after_update, at_a_terminal, number):
    """Only the evaluation is left; the old one, of other weights, is gone. Fewer devices can export the run."""
    assert ppo.main([*TINY, "--run-dir=run"]) == 0
    run = probe / "run"
    assert (run / "evaluation.json").exists()
    after_update(8, lambda: os.kill(os.getpid(), number))
    more = ["--resume=run", "--total-timesteps=128", "--updates-per-call=1"]
    assert ppo.main(more) == 128 + number
    assert capsys.readouterr().err.endswith("with: python -m train.evaluate --run-dir run\n")
    assert not (run / "evaluation.json").exists()
    settings = (run / "config.json").read_text()
    (run / "config.json").write_text(settings.replace('"num_devices": 0', '"num_devices": 64'))
    assert export.main(["--run-dir=run"]) == 0


def test_a_killed_run_resumes_from_its_checkpoint(probe, whole, after_update):
    after_update(5, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        ppo.main([*QUIET, "--run-dir=parts"])
    assert len(rows_of(probe / "parts")) == 5  # one more than the checkpoint of update 4
    with (probe / "parts" / "metrics.jsonl").open("a") as file:
        file.write('{"update": 6, "env_st')  # cut off in the writing
    assert ppo.main(["--resume=parts"]) == 0
    assert_same_run(whole, probe / "parts")


def test_resume_refuses_what_does_not_fit(probe, whole, capsys):
    shutil.copytree(whole, probe / "run")
    before = files_of(probe / "run")
    refused(capsys, ["--resume=run"], "96 decisions", "--total-timesteps above 96")
    more = ["--resume=run", "--total-timesteps=1000"]
    for change, words in (
        (["--num-envs=8"], "num_envs 8, which was 4: checkpoint"),
        (["--hidden", "8"], "hidden (8,), which was (4,): checkpoint"),
        (["--num-seeds=2"], "num_seeds 2, which was 1: checkpoint"),
    ):
        refused(capsys, [*more, *change], words, "of another shape", "allowed: (")
    # These would fit, but earlier updates would count as updates of another size.
    for change, words in (
        ("--rollout-length=2", "rollout_length 2, which was 4 until now, allowed: 4"),
        ("--decide-every=2", "decide_every 2, which was 1 until now, allowed: 1"),
        ("--num-epochs=1", "num_epochs 1, which was 4 until now, allowed: 4"),
        ("--num-minibatches=1", "num_minibatches 1, which was 2 until now, allowed: 2"),
        (
            "--normalize-observations --policy-prior=wait",
            "normalize_observations True, which was False until now, allowed: False",
        ),
        # And with these the weights would be another policy, or have another start.
        ("--activation=tanh", "activation tanh, which was silu until now, allowed: silu"),
        (
            "--rule-sharpness=1",
            "rule_sharpness 1.0, which was 4.0 until now, allowed: 4.0",
        ),
        ("--initial-wait=0.5", "initial_wait 0.5, which was 0.8 until now, allowed: 0.8"),
        ("--seed=3", "seed 3, which was 0 until now, allowed: 0"),
    ):
        refused(capsys, [*more, *change.split()], words)
    metrics = probe / "run" / "metrics.jsonl"
    rows = metrics.read_text()
    metrics.write_text("not JSON\n" + rows)
    refused(capsys, more, "metrics.jsonl, line 1 = 'not JSON': allowed JSON")
    metrics.write_text(rows)
    refused(capsys, [*TINY, "--run-dir=run"], "already holds files")
    assert before == files_of(probe / "run")
    assert ppo.main(["--resume=run", "--total-timesteps=128"]) == 0
    assert len(rows_of(probe / "run")) == 8
    assert (probe / "run" / "config-until-6.json").exists()


@pytest.mark.parametrize("result", ["summary.json", "policy.zip"])
def test_a_run_that_lost_its_checkpoints_keeps_its_rows(probe, whole, capsys, result):
    """It ended, so that it cannot begin anew; its rows are all that is left of the training."""
    run = shutil.copytree(whole, probe / "run", ignore=shutil.ignore_patterns("checkpoints"))
    for other in {"summary.json", "policy.zip"} - {result}:
        (run / other).unlink()
    before = files_of(run)
    words = ("run run has results but no checkpoint", "allowed: one with its checkpoints")
    refused(capsys, ["--resume=run"], *words)
    assert files_of(run) == before


@pytest.mark.parametrize(
    "place",
    ["runs.session.Session._compile", "runs.open_session.make_train", "evaluate.whole_numbers"],
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_before_the_first_update(
    probe, capsys, monkeypatch, at_a_terminal, place, number
):
    """During tracing, compiling or evaluation: one line, and nothing is left."""
    command, argv = (evaluate, []) if place.startswith("evaluate") else (ppo, TINY)
    monkeypatch.setattr(f"train.{place}", lambda *_, **__: signal.raise_signal(number))
    assert command.main([*argv, "--run-dir=run"]) == 128 + number
    err = capsys.readouterr().err
    assert err.startswith("interrupted")
    assert err.count("\n") == 1
    assert not (probe / "run").exists()
    (probe / "run").mkdir()  # a directory that the user made stays, empty
    monkeypatch.setattr(f"train.{place}", lambda *_, **__: signal.raise_signal(number))
    assert command.main([*argv, "--run-dir=run"]) == 128 + number
    assert list((probe / "run").iterdir()) == []


@pytest.mark.thorough
def test_evaluate_command(probe, capsys):
    assert ppo.main([*TINY, "--num-seeds=2", "--eval-episodes=0", "--run-dir=run"]) == 0

    def result(*argv):
        assert evaluate.main([*argv, "--episodes=5", "--json=out.json"]) == 0
        return json.loads((probe / "out.json").read_text())

    run, three = ("--run-dir=run", "--batch=2"), ("--set", "episode_decisions=3")
    whole = result(*run)
    assert (whole["episodes"], whole["scenario"]) == (5, "noisy")
    assert (whole["overrides"], whole["seed"]) == ({}, 0)
    learned = {f"{name}{end}" for name in ("ppo", "ppo_seed2", "start") for end in ("", "_sampled")}
    assert set(whole["policies"]) == {*learned, "none", "random"}
    entry = whole["policies"]["ppo"]
    low, high = entry["return_ci95"]
    assert low <= entry["return_mean"] <= high
    assert entry["decisions"] == 5.0
    others = {*learned, "none", "random"} - {"ppo", "ppo_seed2"}
    assert set(whole["paired_return_difference"]) == others
    assert len(whole["training_seeds"]["return_means"]) == 2
    some = result(*run, "--policies=ppo,random", "--baseline=none", *three)
    assert set(some["policies"]) == {"ppo", "random", "none"}
    assert set(some["difference_from_baseline"]) == {"ppo", "random"}
    means = {name: entry["return_mean"] for name, entry in some["policies"].items()}
    gain = some["difference_from_baseline"]["random"]["mean"]
    assert gain == pytest.approx(means["random"] - means["none"])
    assert some["overrides"] == {"episode_decisions": 3}
    other = result(*run, "--stochastic", *three, "--seed=4")
    assert other["policies"]["none"]["decisions"] == 3.0
    printed = capsys.readouterr()
    assert "5 whole episodes of noisy" in printed.out
    assert printed.err.startswith("python -m train.evaluate: --stochastic is not needed")
    # Without a run: a file, a rule, and a function that builds a policy, in the world of the file.
    file, built = "run/policy.zip", "tests.train.conftest:coin"
    without = result(f"--policies={file},random,{built}", *three, "--baseline=none")
    assert without["policies"]["random"] == without["policies"][built]
    for name in ("none", "random"):
        assert without["policies"][name] == some["policies"][name]
    same = without["policies"][file]["return_mean"]
    assert same == pytest.approx(some["policies"]["ppo"]["return_mean"], rel=1e-6)
    assert (without["scenario"], without["overrides"]) == ("noisy", {"episode_decisions": 3})
    capsys.readouterr()
    refused(capsys, ["--episodes=3"], "neither --run-dir nor --policies", command=evaluate)
    for name in ("gone.zip", "tests.train.conftest:gone", "nowhere:act", "a:b:c", "best"):
        refused(capsys, [f"--policies=none,{name}"], f"policy '{name}'", command=evaluate)
    refused(capsys, [*run, "--scenario=nowhere"], "nowhere", command=evaluate)
    refused(capsys, [*run, "--set", "x=1"], "'x'", command=evaluate)
    of_run = "ppo, ppo_sampled, ppo_seed2, ppo_seed2_sampled, start, start_sampled"
    said = f"unknown policy 'all': allowed {of_run}, {', '.join(BASELINES)}, pretrained,"
    for option in ("policies", "baseline"):
        refused(capsys, [*run, f"--{option}=all"], said, command=evaluate)
