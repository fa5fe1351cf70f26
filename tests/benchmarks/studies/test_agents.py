"""Agents at a constant speed, and trained ones, beside the dispatcher alone."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.studies import agents
from medjax.agents import agents_of
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import BASELINES
from medjax.policies.team import as_team
from tests.benchmarks.refusal import refused
from train.algorithms.ppo.settings import PPOConfig
from train.runs.run_directory import RunDir

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"size": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0, "episode_decisions": 40}
SET = [f"--set={name}={value}" for name, value in SMALL.items()]


@pytest.mark.thorough
def test_rows_are_the_episodes_of_each_speed(tmp_path, monkeypatch, capsys):
    """The default is the dispatcher's own score, as is the fleet's speed; a slow MED changes the episode."""

    def load(path):
        """A policy of agents that does as the rule `none`."""
        about = SimpleNamespace(agents={"speeds": (14.0, 22.0)}, scenario="paper", name="learned")
        world = agents_of("paper", speeds=(14.0, 22.0), **SMALL)
        policy = lambda env: as_team(env, BASELINES["none"](env.env))  # noqa: E731
        return SimpleNamespace(about=about, make=lambda *_: world, policy=policy)

    monkeypatch.setattr(agents, "load_policy", load)
    out = tmp_path / "out.json"
    argv = ["--episodes=2", "--seed=3", "--speeds", "14", "22", "--policy=its.zip", *SET]
    agents.main([*argv, f"--json={out}"])
    report = json.loads(out.read_text())
    rows = {row["motion"]: row for row in report["rows"]}
    speeds = ["14 m/s", "22 m/s"]
    refusing = [f"{speed}, refuses all" for speed in speeds]
    assert list(rows) == ["default", *speeds, *refusing, "learned"]
    printed = capsys.readouterr().out
    assert all(name in printed for name in rows)

    env, params = agents_of("paper", **SMALL)
    single = {name: BASELINES[name](env.env) for name in ("budgeted", "none")}
    scores = evaluate_policies(env.env, params, single, 2, 3)
    for row, rule in (("default", "budgeted"), ("22 m/s", "budgeted"), ("learned", "none")):
        returns = scores[rule]["return"]
        assert rows[row]["return"] == pytest.approx(np.mean(returns), rel=1e-5)
        change = np.mean(returns - scores["budgeted"]["return"])
        assert rows[row]["return_change"] == pytest.approx(change, rel=1e-4, abs=1e-3)
    assert rows["default"]["return_change"] == 0.0
    assert rows["14 m/s"]["return_change"] != 0.0
    assert [row["invalid_actions"] for row in rows.values()] == [0.0] * 6
    assert 14.0 <= rows["14 m/s"]["told_speed"] < 14.5
    # The control drives as told and serves nobody.
    assert 14.0 <= rows["14 m/s, refuses all"]["told_speed"] < 14.5
    assert [rows[name]["ev_received_kwh"] for name in refusing] == [0.0, 0.0]


@pytest.mark.thorough
def test_overrides_change_the_episodes(tmp_path, capsys):
    """Slots without power send nothing; the report and the heading name the override."""
    out = tmp_path / "out.json"
    argv = ["--episodes=2", "--speeds", "14", *SET, "--set=charging.slot_power_w=0"]
    agents.main([*argv, f"--json={out}"])
    result = json.loads(out.read_text())
    assert result["overrides"][-1] == "charging.slot_power_w=0"
    assert [row["motion"] for row in result["rows"]] == ["default", "14 m/s", "14 m/s, refuses all"]
    assert [row["ev_received_kwh"] for row in result["rows"]] == [0.0, 0.0, 0.0]
    assert "charging.slot_power_w=0, 2 episodes" in capsys.readouterr().out


@pytest.mark.thorough
def test_the_learners_of_a_run_play_against_any_row(tmp_path, monkeypatch):
    """The rules that a run brings are not rows; differences are from the baseline."""

    def load(run_dir, config):
        """A learner that does as the rule `none`."""
        assert (run_dir.name, config.agents) == ("its", "ippo")
        env, params = agents_of("paper", speeds=(14.0, 22.0), **SMALL)
        none = as_team(env, BASELINES["none"](env.env))
        return env, params, {"learned": none, "greedy": none}

    monkeypatch.setattr(agents, "settings", lambda options: PPOConfig(agents="ippo"))
    monkeypatch.setattr(agents, "load_policies", load)
    out = tmp_path / "out.json"
    argv = ["--episodes=2", "--speeds", "14", "--baseline=14 m/s", "--run-dir=its"]
    agents.main([*argv, f"--json={out}"])
    rows = {row["motion"]: row for row in json.loads(out.read_text())["rows"]}
    assert list(rows) == ["default", "14 m/s", "14 m/s, refuses all", "learned"]
    assert rows["14 m/s"]["return_change"] == 0.0
    for row in rows.values():
        change = row["return"] - rows["14 m/s"]["return"]
        assert row["return_change"] == pytest.approx(change, rel=1e-4)


def test_bad_input_is_one_line(tmp_path, capsys):
    RunDir(tmp_path / "run").claim(PPOConfig()).close()
    for argv, word in (
        (["--set=no_such=3"], "no_such"),
        (["--set=speeds=3"], "speeds"),
        (["--speeds", "0.5"], "'0.5'"),
        (["--speeds", "fast"], "'fast'"),
        (["--scenario=nowhere"], "nowhere"),
        ([f"--policy={tmp_path / 'none.zip'}"], "none.zip"),
        (["--policy=its.zip", "--run-dir=its"], "one of the two"),
        (["--run-dir=nowhere"], "nowhere"),
        (["--baseline=20 m/s"], "20 m/s"),
        ([f"--run-dir={tmp_path / 'run'}"], "is of a dispatcher"),
    ):
        assert word in refused(agents.main, argv, capsys), argv
