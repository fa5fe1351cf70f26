"""Paired evaluation, and its intervals against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from medjax.episodes.keys import EVALUATION
from medjax.episodes.scores import evaluate_policies
from medjax.policies.policy import Choice, Policy, rule
from tests.train.conftest import coin, never
from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.networks import PolicyWeights, apply_policy, build_network
from train.algorithms.normalization import init_stats
from train.algorithms.policy import learned_policy
from train.evaluation.scores import summarize
from train.evaluation.statistics import bootstrap_ci95, interquartile_mean, relative_change
from train.evaluation.tables import format_table
from train.settings import TrainConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

ENV, PARAMS = Probe("noisy"), ProbeParams(episode_decisions=6)


def test_the_same_policy_twice_is_the_same_and_differences_are_the_policies_own():
    one = rule(lambda key, state, params: jnp.int32(1), 2)
    policies = {
        "a": coin(ENV),
        "b": coin(ENV),
        "none": never(ENV),
        "one": one,
    }
    scores = evaluate_policies(ENV, PARAMS, policies, episodes=7, seed=3, batch=4)
    assert set(scores["a"]) == {"return", "length", "total", "decisions"}
    for name in scores["a"]:
        assert scores["a"][name].shape == (7,)
        np.testing.assert_array_equal(scores["a"][name], scores["b"][name])
    # Same noise for both: action 1 adds exactly 1 to each of the six rewards.
    np.testing.assert_allclose(scores["one"]["return"] - scores["none"]["return"], 6.0, rtol=1e-5)
    np.testing.assert_allclose(scores["a"]["return"], scores["a"]["total"], rtol=1e-6)
    np.testing.assert_array_equal(scores["a"]["length"], 6.0)
    assert len(np.unique(scores["none"]["return"])) == 7
    again = evaluate_policies(ENV, PARAMS, policies, episodes=7, seed=3, batch=7)
    np.testing.assert_allclose(again["a"]["return"], scores["a"]["return"], rtol=1e-6)
    other = evaluate_policies(ENV, PARAMS, policies, episodes=7, seed=4, batch=7)
    assert (other["none"]["return"] != scores["none"]["return"]).all()


def test_equals_one_episode_stepped_by_hand():
    scores = evaluate_policies(ENV, PARAMS, {"coin": coin(ENV)}, episodes=2, seed=9)
    root = jax.random.fold_in(jax.random.key(9), EVALUATION)
    for episode in range(2):
        reset_key, step_key, act_key = jax.random.split(jax.random.fold_in(root, episode), 3)
        _, state = ENV.reset(reset_key, PARAMS)
        total, truncated, time = 0.0, False, 0
        while not truncated:
            action = coin(ENV)(jax.random.fold_in(act_key, time), None, state, PARAMS).action
            key = jax.random.fold_in(step_key, time)
            _, state, reward, _, truncated, _ = ENV.step_env(key, state, action, PARAMS)
            total, time = total + float(reward), time + 1
        assert scores["coin"]["return"][episode] == pytest.approx(total, rel=1e-5)


def test_nothing_counts_after_the_end_of_an_episode():
    env, params = Probe("constant_terminated"), ProbeParams(episode_decisions=3)
    ends_early = Probe("follow"), ProbeParams(episode_decisions=50)
    scores = evaluate_policies(env, params, {"none": never(env)}, 3)
    np.testing.assert_array_equal(scores["none"]["return"], 3.0)
    scores = evaluate_policies(*ends_early, {"none": never(env)}, 5)
    np.testing.assert_array_equal(scores["none"]["length"], 1.0)
    assert set(scores["none"]["return"]) <= {0.0, 1.0}


def test_forbidden_actions_count_as_none():
    env = Probe("masked", num_actions=3)
    two = Policy(
        lambda weights, key, obs, state, params: Choice(weights, jax.nn.one_hot(weights, 3)),
        jnp.int32(2),
    )
    scores = evaluate_policies(env, ProbeParams(), {"two": two, "none": never(env)}, 20)
    np.testing.assert_array_equal(scores["two"]["return"], scores["none"]["return"])


def untrained(initial_wait):
    """A network on the noisy probe, and its weights before training."""
    network = build_network(ENV, TrainConfig(initial_wait=initial_wait))
    params = network.init(jax.random.key(0), jnp.zeros((1, 2)))
    return network, PolicyWeights(params, init_stats((2,)))


def test_the_first_policy_waits_as_often_as_it_is_told():
    network, weights = untrained(0.8)
    obs = jax.random.normal(jax.random.key(1), (50, 2))
    policy, _ = apply_policy(network, weights, obs, jnp.ones((50, 2), bool))
    np.testing.assert_allclose(policy.probs[:, 0], 0.8, atol=0.02)


@pytest.mark.parametrize(("interval", "choices"), [(1, 6), (4, 2), (6, 1)])
def test_a_trained_policy_waits_between_its_choices(interval, choices):
    """Always action 1 where it chooses, each worth 1: at decisions 0, interval, 2 interval, ... of six."""
    policy = learned_policy(ENV, *untrained(0.01), interval)
    policies = {"ppo": policy, "none": never(ENV)}
    scores = evaluate_policies(ENV, PARAMS, policies, episodes=5)
    gain = scores["ppo"]["return"] - scores["none"]["return"]
    np.testing.assert_allclose(gain, choices, rtol=1e-5)


def test_bootstrap_is_the_normal_interval_for_many_samples():
    samples = np.random.default_rng(0).normal(3.0, 2.0, 2000)
    low, high = bootstrap_ci95(samples)
    half = 1.96 * samples.std() / np.sqrt(samples.size)
    assert low == pytest.approx(samples.mean() - half, abs=0.03 * half)
    assert high == pytest.approx(samples.mean() + half, abs=0.03 * half)


def test_bootstrap_equals_scipys_for_few_skewed_samples():
    samples = np.random.default_rng(1).exponential(size=25)
    expected = stats.bootstrap(
        (samples,), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(2)
    ).confidence_interval
    got = bootstrap_ci95(samples)
    width = expected.high - expected.low
    np.testing.assert_allclose(got, expected, atol=0.04 * width)
    assert bootstrap_ci95(samples) == got
    assert bootstrap_ci95(np.full(5, 2.0)) == (2.0, 2.0)
    assert np.isnan(bootstrap_ci95(np.zeros(0))).all()


def test_the_interval_of_a_relative_change_is_scipys():
    rng = np.random.default_rng(3)
    base = rng.normal(10.0, 2.0, 80)
    pairs = np.stack([0.4 * base + rng.normal(0.0, 0.5, 80), base], axis=1)
    expected = stats.bootstrap(
        tuple(pairs.T),
        lambda ours, theirs, axis: ours.mean(axis) / theirs.mean(axis) - 1.0,
        paired=True,
        n_resamples=20_000,
        method="percentile",
        rng=np.random.default_rng(2),
    ).confidence_interval
    got = bootstrap_ci95(pairs, statistic=relative_change)
    np.testing.assert_allclose(got, expected, atol=0.04 * (expected.high - expected.low))


def test_no_share_of_nothing():
    """No action sends nobody to the shoulder in most episodes: there is no interval to give."""
    none = {"return": np.zeros(3), "depleted_share": np.array([0.0, 0.0, 0.1])}
    ours = {"return": np.ones(3), "depleted_share": np.zeros(3)}
    assert "change_against_none" not in summarize({"ppo": ours, "none": none}, "paper", ["ppo"])


@pytest.mark.parametrize("size", [1, 3, 4, 7, 8])
def test_interquartile_mean_is_scipys_trimmed_mean(size):
    samples = np.random.default_rng(size).exponential(size=(5, size))
    expected = stats.trim_mean(samples, 0.25, axis=1)
    np.testing.assert_allclose(interquartile_mean(samples), expected, rtol=1e-12)


def test_several_training_seeds_are_compared_by_their_mean():
    """By hand for two seeds, three episodes."""
    ours = [np.array([1.0, 2.0, 6.0]), np.array([3.0, 2.0, 0.0])]
    scores = {
        name: {"return": returns, "length": np.full(3, 6.0), "mean_range_m": returns + 10.0}
        for name, returns in zip(("ppo", "ppo_seed2"), ours, strict=True)
    }
    scores["none"] = {
        "return": np.zeros(3),
        "length": np.full(3, 6.0),
        "mean_range_m": np.full(3, 10.0),
    }
    learned = ["ppo", "ppo_seed2"]
    result = summarize(scores, "paper", learned)
    assert list(result["paired_return_difference"]) == ["none"]
    assert result["paired_return_difference"]["none"]["mean"] == pytest.approx(7.0 / 3.0)
    assert result["change_against_none"]["mean_range_m"]["mean"] == pytest.approx(0.7 / 3.0)
    seeds = result["training_seeds"]
    assert seeds["return_means"] == pytest.approx([3.0, 5.0 / 3.0])
    assert seeds["interquartile_mean"] == pytest.approx(7.0 / 3.0)
    assert seeds["ci95"] == pytest.approx([5.0 / 3.0, 3.0])
    own = [gains["none"] for gains in seeds["paired_return_differences"]]
    assert [gain["mean"] for gain in own] == pytest.approx([3.0, 5.0 / 3.0])
    assert all(gain["ci95"][0] < gain["mean"] < gain["ci95"][1] for gain in own)
    assert f"each minus none, 95 % CI: 3.000 [{own[0]['ci95'][0]:.3f}" in format_table(
        result, learned
    )


def test_summary_has_the_contracts_names():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=50) * 100
    scores = {
        "ppo": {"return": noise + 5.0, "length": np.full(50, 6.0), "mean_soc": np.full(50, 0.5)},
        "none": {
            "return": noise + rng.normal(size=50),
            "length": np.full(50, 6.0),
            "mean_soc": np.zeros(50),
        },
    }
    result = summarize(scores, "paper", ["ppo"])
    assert result["episodes"] == 50
    assert result["scenario"] == "paper"
    entry = result["policies"]["ppo"]
    assert entry["return_mean"] == pytest.approx(scores["ppo"]["return"].mean())
    assert entry["return_std"] == pytest.approx(scores["ppo"]["return"].std(ddof=1))
    assert entry["mean_soc"] == 0.5
    # The paired difference is far sharper than the two intervals.
    low, high = result["paired_return_difference"]["none"]["ci95"]
    assert 4.0 < low < high < 6.0
    assert np.ptp(entry["return_ci95"]) > 20
