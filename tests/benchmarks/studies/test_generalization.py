"""The command plays every policy at every demand as the evaluation does."""

import dataclasses
import json

import jax
import numpy as np
import pytest

from benchmarks.studies import generalization
from medjax.episodes.scores import evaluate_policies
from medjax.scenarios import SCENARIOS
from medjax.world.params import EnvConfig
from tests.benchmarks.refusal import refused
from train.algorithms.environments import make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train
from train.evaluation.tables import interval, short
from train.runs.checkpoint import Checkpoints, to_host
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir
from train.runs.session import ONCE

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 8, "num_gas": 40, "episode_decisions": 20}


def untrained(path, observation):
    """A run of no update, on a road with few slots."""
    learner = {"num_envs": 2, "num_minibatches": 2, "hidden": (4,), "initial_wait": 0.1}
    given = PPOConfig(**learner, observation=observation, overrides=SMALL)
    config = given.for_episodes(SMALL["episode_decisions"])
    env, params = make_environment(config)
    RunDir(path).claim(config)
    lowered = make_train(env, params, config).init.lower(jax.random.key(0), params)
    state = lowered.compile(compiler_options=ONCE)(jax.random.key(0), params)
    Checkpoints(path).save(to_host(state), config)
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs that see the road profile, and the flat observation."""
    root = tmp_path_factory.mktemp("runs")
    return [untrained(root / name, name) for name in ("profile", "flat")]


@pytest.fixture(autouse=True)
def few_slots(monkeypatch):
    monkeypatch.setattr(generalization, "SIZES", SMALL)


@pytest.mark.slow
def test_demands_and_policies_side_by_side(runs, tmp_path, capsys):
    """The preset's own demand is what train.evaluate plays; others have other traffic; any observation takes part."""
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    argv = ["--run-dir", *map(str, runs), "--episodes=4", "--seed=3"]
    generalization.main([*argv, f"--json={out}", f"--plot={picture}"])
    printed = capsys.readouterr().out
    worlds = json.loads(out.read_text())["worlds"]
    demands = list(generalization.AT_FACTORS)
    assert list(worlds) == [*demands, "realistic"]

    env, params, policies = load_policies(runs[0], RunDir(runs[0]).load_config())
    policies = {name: policies[name] for name in ("ppo", "ppo_sampled", *generalization.RULES)}
    scores = evaluate_policies(env, params, policies, episodes=4, seed=3)
    scores["profile"], scores["profile_sampled"] = scores.pop("ppo"), scores.pop("ppo_sampled")
    assert (scores["profile"]["return"] != scores["profile_sampled"]["return"]).any()
    played = worlds["paper x 1"]
    assert set(played["policies"]) == {*scores, "flat", "flat_sampled"}
    # A difference is no finer than the float32 returns that it is taken of.
    largest = max(np.abs(score["return"]).max() for score in scores.values())
    digit = 4 * float(np.spacing(np.float32(largest)))
    for name, score in scores.items():
        entry = played["policies"][name]
        assert entry["return_mean"] == pytest.approx(score["return"].mean(), rel=1e-4)
        assert entry["meds_dispatched"] == score["meds_dispatched"].mean()
        low, high = entry["return_ci95"]
        assert low <= entry["return_mean"] <= high
        assert f"{short(entry['return_mean'])} {interval((low, high))}" in printed
        assert played["minus_none"].get(name, {"mean": 0.0})["mean"] == pytest.approx(
            (score["return"] - scores["none"]["return"]).mean(), rel=1e-3, abs=digit
        )
    gain = played["minus_budgeted"]["profile"]
    difference = scores["profile"]["return"] - scores["budgeted"]["return"]
    assert gain["mean"] == pytest.approx(difference.mean(), rel=1e-3, abs=digit)
    assert f"{short(gain['mean'])} {interval(gain['ci95'])}" in printed.split("minus budgeted")[1]

    vehicles = [worlds[name]["policies"]["none"]["vehicle_ticks"] for name in demands]
    assert (np.diff(vehicles) > 0).all()
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_a_run_that_does_not_fit_the_other_preset_is_refused(runs, monkeypatch, capsys):
    """With another number of ramps, and so of actions."""
    other = dataclasses.replace(SCENARIOS["realistic"], config=EnvConfig(num_ramps=3))
    monkeypatch.setitem(SCENARIOS, "realistic", other)
    for run in runs:
        names = [run.name, f"{run.name}_sampled"]
        assert list(generalization.load_runs([run], "paper")) == names
        error = refused(generalization.main, ["--run-dir", str(run)], capsys)
        assert "of another shape" in error
        assert str(run) in error


@pytest.mark.thorough
def test_bad_input_is_one_line(runs, tmp_path, monkeypatch, capsys):
    """Exit code 2, and the value is named."""
    run = str(runs[1])
    for argv, word in (
        ([], "--run-dir"),
        (["--run-dir"], "--run-dir"),
        (["--run-dir", "absent"], "absent"),
        (["--run-dir", str(tmp_path)], "config.json"),
        (["--run-dir", run, run], "flat"),
        (["--run-dir", run, "--episodes=1"], "'1'"),
        (["--run-dir", run, "--seed=-1"], "'-1'"),
        (["--run-dir", run, "--plot=absent/file.png"], "absent/file.png"),
        (["--run-dir", run, "--json=."], "is a directory"),
    ):
        assert word in refused(generalization.main, argv, capsys), argv
    monkeypatch.setitem(SMALL, "num_evs", 6)
    assert "of another shape" in refused(generalization.main, ["--run-dir", run], capsys)
