"""A sweep trains every learner as train.ppo does, refuses what cannot vary, and reports by hand-made scores."""

import dataclasses
import itertools
import json

import jax
import numpy as np
import pytest
from scipy import stats

import medjax
from benchmarks.studies import sweep
from benchmarks.studies.sweep import combinations, learn, play, read_vary
from benchmarks.studies.sweep_tables import describe, table
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from tests.benchmarks.refusal import refused
from train import ppo
from train.algorithms.ppo.learner import PPO
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train
from train.evaluation.statistics import improvement_probability

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}
SIZES = {"num_envs": 4, "num_minibatches": 2, "rollout_length": 20, "hidden": (4,)}


@pytest.mark.thorough
def test_learners_are_those_of_train_ppo():
    """With the default and with other numbers, each seed; rounding differs between the programs."""
    config = PPOConfig(**SIZES, num_seeds=2, total_timesteps=160, overrides=SMALL, seed=5)
    env, params = medjax.make("paper", observation=config.observation, **SMALL)
    rows = [
        {"learning_rate": 1e-3, "gamma": 1.0, "rule_sharpness": 4.0},
        {"learning_rate": 3e-3, "gamma": 0.9, "rule_sharpness": 1.0},
    ]
    learned = learn(env, params, config, rows)
    assert learned.curve.shape == (2, 2, 2)
    for index, numbers in enumerate(rows):
        alone = PPOConfig(**SIZES, num_seeds=2, total_timesteps=160, seed=5, **numbers)
        programs = make_train(env, params, alone)
        state = programs.init(jax.random.key(5), params)
        start = jax.device_get(state.weights)
        state, metrics = programs.run(state, params, np.int32(2))
        for found, expected in (
            (jax.tree.map(lambda leaf, own=index: leaf[own], learned.weights), state.weights),
            (jax.tree.map(lambda leaf, own=index: leaf[own], learned.start), start),
        ):
            for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-5)
        returns = np.asarray(metrics["episode_return"])[:, :2].T
        np.testing.assert_allclose(learned.curve[:, index], returns, rtol=1e-4)
    # The numbers matter.
    first, second = (learned.weights.params["params"]["logits_head"]["kernel"][i] for i in (0, 1))
    assert not np.allclose(first, second, atol=1e-4)


@pytest.mark.thorough
def test_a_learner_plays_with_the_rule_that_it_started_from():
    """Its network adds to that rule's logits, so another row's network would play another policy."""
    config = PPOConfig(**SIZES, total_timesteps=80, eval_episodes=6, overrides=SMALL)
    env, params = medjax.make("paper", observation=config.observation, **SMALL)
    rows = [{"rule_sharpness": 4.0}, {"rule_sharpness": 0.01}]
    learned = learn(env, params, config, rows)
    played, starts, _ = play(env, params, config, rows, learned)
    weights, start = (
        jax.tree.map(lambda leaf: leaf[1, 0], tree) for tree in (learned.weights, learned.start)
    )
    other, own = (dataclasses.replace(config, **row) for row in rows)
    policies = {
        "other": PPO.policy(env, other, weights, stochastic=True),
        "own": PPO.policy(env, own, weights, stochastic=True),
        "start": PPO.policy(env, own, start, stochastic=True),
    }
    alone = evaluate_policies(env, params, policies, config.eval_episodes, config.seed)
    found = played["ppo_sampled"][1][0]["return"]
    np.testing.assert_allclose(found, alone["own"]["return"], rtol=1e-5)
    assert not np.allclose(found, alone["other"]["return"], rtol=1e-2)
    np.testing.assert_allclose(
        starts["start_sampled"][1]["return"], alone["start"]["return"], rtol=1e-5
    )
    assert not np.allclose(starts["start_sampled"][0]["return"], alone["start"]["return"])


def test_combinations_begin_with_the_default_and_repeat_nothing():
    config = PPOConfig(learning_rate=1e-3)
    rows = combinations(config, {"learning_rate": [3e-4, 1e-3], "gamma": [1.0, 0.9]})
    assert rows[0] == {"learning_rate": 1e-3, "gamma": 1.0}
    every = {tuple(row.values()) for row in rows}
    assert every == set(itertools.product([3e-4, 1e-3], [1.0, 0.9]))
    assert len(rows) == 4
    # A default that is not among the values is one more row.
    assert combinations(config, {"gamma": [0.9]}) == [{"gamma": 1.0}, {"gamma": 0.9}]
    # The default of a number that follows the number of environments.
    for num_envs, usual in ((32, 5e-4), (1024, 1e-3)):
        follows = PPOConfig(num_envs=num_envs).for_episodes(600)
        rows = combinations(follows, {"learning_rate": [2e-3]})
        assert rows == [{"learning_rate": pytest.approx(usual)}, {"learning_rate": 2e-3}]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("num_envs=1,2", "--vary 'num_envs': allowed learning_rate, gamma, "),
        ("observation=flat,profile", "--vary 'observation': allowed learning_rate, "),
        ("lr", "--vary 'lr': allowed NAME=NUMBER,NUMBER,..."),
        ("lr=", "allowed NAME=NUMBER"),
        ("lr=0,1e-3", "learning_rate is 0.0, allowed: at least 1e-12"),
        ("lr=1e-3,fast", "allowed NAME=NUMBER"),
        ("gamma=0.9,1.5", "gamma is 1.5, allowed: at least 0, at most 1"),
        ("gamma=nan", "gamma is nan"),
    ],
)
def test_what_cannot_vary_is_refused_in_a_line(text, said, capsys):
    assert said in refused(sweep.main, [f"--vary={text}"], capsys)


def test_other_bad_input_is_refused_in_a_line(capsys):
    assert "no --vary, allowed: at least one" in refused(sweep.main, [], capsys)
    twice = ["--vary=lr=1e-3", "--vary=learning-rate=1e-4"]
    assert "is given twice" in refused(sweep.main, twice, capsys)
    for argv, said in (
        (["--eval-episodes=0"], "eval_episodes is 0"),
        (["--seeds=0"], "num_seeds is 0"),
        (["--scenario=nowhere"], "nowhere"),
        (["--plot=a.pdf"], "allowed a name that ends in .png"),
    ):
        assert said in refused(sweep.main, ["--vary=lr=1e-3", *argv], capsys)
    for argv in (["--policy-prior=wait"], ["--observation=flat", "--network=mlp"]):
        said = refused(sweep.main, ["--vary=rule-sharpness=1", *argv], capsys)
        assert "--vary rule_sharpness: allowed where the first policy is the rule's" in said


def test_names_of_settings_and_their_short_forms():
    assert read_vary(["lr=3e-4,1e-3", "gae-lambda=0.95"]) == {
        "learning_rate": [3e-4, 1e-3],
        "gae_lambda": [0.95],
    }
    with pytest.raises(InputError):
        read_vary([])


def test_the_report_is_that_of_scores_by_hand():
    """Two settings, three seeds; the second is better by 10 with each seed and loses 1 sampled."""
    rng = np.random.default_rng(0)
    demand = rng.normal(size=200) * 50
    luck = np.array([-1.0, 0.0, 1.0])
    scores = lambda gain: [{"return": demand + gain + own} for own in luck]  # noqa: E731
    played = {
        "ppo": [scores(0.0), scores(10.0)],
        "ppo_sampled": [scores(0.0), scores(9.0)],
    }
    starts = [{"return": demand - 2.0}, {"return": demand - 5.0}]
    first, second = describe([{"gamma": 1.0}, {"gamma": 0.9}], played, starts, 0)
    assert first["settings"] == {"gamma": 1.0}
    assert first["minus_default"] == {"mean": 0.0, "ci95": [0.0, 0.0]}
    assert first["probability_of_improvement"]["mean"] == 0.5
    assert second["return_means"] == pytest.approx(demand.mean() + 10.0 + luck)
    assert second["minus_default"]["mean"] == pytest.approx(10.0)
    assert second["minus_default"]["ci95"] == pytest.approx([10.0, 10.0])
    assert second["minus_sampled"]["mean"] == pytest.approx(1.0)
    assert first["minus_start"]["mean"] == pytest.approx(2.0)
    assert second["minus_start"]["mean"] == pytest.approx(15.0)
    low, high = second["minus_start"]["ci95"]
    assert 14.0 <= low < 15.0 < high <= 16.0  # seeds differ
    assert second["probability_of_improvement"] == {"mean": 1.0, "ci95": [1.0, 1.0]}
    headings, default, other = table([first, second])
    assert len(headings) == len(default) == len(other)
    assert default[-2:] == ["", ""]
    assert other[-1] == "1.000 [1.000, 1.000]"


def test_probability_of_improvement_is_mann_whitneys():
    """U / (n m) by SciPy, ties included; a set against itself gives one half."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        new, old = rng.integers(0, 6, 5), rng.integers(0, 6, 7)
        found, (low, high) = improvement_probability(new, old)
        u = stats.mannwhitneyu(new, old, method="asymptotic").statistic
        assert found == pytest.approx(u / 35)
        assert low <= found <= high
    assert improvement_probability(new, new)[0] == 0.5


@pytest.mark.thorough
def test_command(tmp_path, capsys, monkeypatch):
    """Rows in print and as JSON, and a picture; the default's learners are those of a run of train.ppo."""
    monkeypatch.setattr(sweep, "enable_compilation_cache", lambda: None)
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    options = ["--num-envs=4", "--num-minibatches=2", "--rollout-length=20", "--hidden", "4"]
    options += ["--total-timesteps=160", "--eval-episodes=3", "--seeds=2", "--seed=5"]
    options += [f"--set={name}={value}" for name, value in SMALL.items()]
    sweep.main(["--vary=lr=1e-2", *options, f"--json={out}", f"--plot={picture}"])
    printed, report = capsys.readouterr().out, json.loads(out.read_text())
    assert [row["settings"] for row in report["rows"]] == [
        {"learning_rate": 5e-4},
        {"learning_rate": 1e-2},
    ]
    assert {"start", "start_sampled", *medjax.BASELINES} == set(report["others"])
    assert "2 settings x 2 seeds on paper, 160 decisions each; 3 episodes" in printed
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert np.shape(report["curve"]) == (2, 2, 2)

    run = tmp_path / "run"
    assert ppo.main([*options, f"--run-dir={run}", "--quiet"]) == 0
    played = json.loads((run / "evaluation.json").read_text())
    alone = [played["policies"][name]["return_mean"] for name in ("ppo", "ppo_seed2")]
    assert report["rows"][0]["return_means"] == pytest.approx(alone, rel=1e-4)
    for name, mean in report["others"].items():
        assert mean == pytest.approx(played["policies"][name]["return_mean"], rel=1e-4)
