"""Paired evaluation."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.episodes import scores as module
from medjax.episodes.keys import EVALUATION
from medjax.episodes.scores import Evaluation, evaluate_policies
from medjax.errors import InputError
from medjax.policies.policy import Choice, Policy, rule
from tests.train.conftest import coin, never
from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.networks import PolicyWeights, apply_policy, build_network, learned_policy
from train.algorithms.normalization import init_stats
from train.algorithms.ppo.settings import PPOConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

ENV, PARAMS = Probe("noisy"), ProbeParams(episode_decisions=6)


def test_policies_face_the_same_episodes():
    one = rule(lambda key, state, params: jnp.int32(1), 2)
    policies = {"a": coin(ENV), "b": coin(ENV), "none": never(ENV), "one": one}
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


def test_rewards_after_the_end_do_not_count():
    env, params = Probe("constant_terminated"), ProbeParams(episode_decisions=3)
    ends_early = Probe("follow"), ProbeParams(episode_decisions=50)
    scores = evaluate_policies(env, params, {"none": never(env)}, 3)
    np.testing.assert_array_equal(scores["none"]["return"], 3.0)
    scores = evaluate_policies(*ends_early, {"none": never(env)}, 5)
    np.testing.assert_array_equal(scores["none"]["length"], 1.0)
    assert set(scores["none"]["return"]) <= {0.0, 1.0}


def test_longer_episodes_than_compiled_are_refused():
    env, policies = Probe("constant_terminated"), {"none": never(Probe("constant_terminated"))}
    built = Evaluation(env, ProbeParams(episode_decisions=5), policies, 2)
    shorter = built.play(policies, 0, ProbeParams(episode_decisions=3))
    np.testing.assert_array_equal(shorter["none"]["length"], 3.0)
    with pytest.raises(InputError, match="episode_decisions is 6, allowed: at most 5"):
        built.play(policies, 0, ProbeParams(episode_decisions=6))


def test_progress_lines_without_a_terminal(capfd, monkeypatch):
    monkeypatch.setattr(module, "SECONDS_PER_LINE", 0.0)
    evaluate_policies(ENV, PARAMS, {"a": coin(ENV)}, episodes=5, batch=2)
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(", ")[0] for line in lines] == [
        "2 of 6 episodes of each policy",
        "4 of 6 episodes of each policy",
    ]
    assert all(re.fullmatch(r"\d+ s left", line.partition(", ")[2]) for line in lines)


def test_policies_of_a_dispatcher_and_of_agents_are_refused():
    both = rule(lambda key, state, params: jnp.zeros(2, jnp.int32), 2)
    message = "^policies of a dispatcher mixed with policies of agents: allowed one of the two"
    with pytest.raises(InputError, match=message):
        evaluate_policies(ENV, PARAMS, {"a": coin(ENV), "both": both}, episodes=2)


def test_masked_actions_count_as_0():
    env = Probe("masked", num_actions=3)
    two = Policy(
        lambda weights, key, obs, state, params: Choice(weights, jax.nn.one_hot(weights, 3)),
        jnp.int32(2),
    )
    scores = evaluate_policies(env, ProbeParams(), {"two": two, "none": never(env)}, 20)
    np.testing.assert_array_equal(scores["two"]["return"], scores["none"]["return"])


def untrained(initial_wait):
    """A network on the noisy probe, and its weights before training."""
    network = build_network(ENV, PPOConfig(initial_wait=initial_wait))
    params = network.init(jax.random.key(0), jnp.zeros((1, 2)))
    return network, PolicyWeights(params, init_stats((2,)))


def test_initial_wait_is_the_first_policys_probability_to_wait():
    network, weights = untrained(0.8)
    obs = jax.random.normal(jax.random.key(1), (50, 2))
    policy, _ = apply_policy(network, weights, obs, jnp.ones((50, 2), bool))
    np.testing.assert_allclose(policy.probs[:, 0], 0.8, atol=0.02)


@pytest.mark.parametrize(("interval", "choices"), [(1, 6), (4, 2), (6, 1)])
def test_a_trained_policy_waits_between_its_choices(interval, choices):
    """It takes action 1, worth 1, at every `interval`-th of six decisions."""
    policy = learned_policy(ENV, *untrained(0.01), interval)
    policies = {"ppo": policy, "none": never(ENV)}
    scores = evaluate_policies(ENV, PARAMS, policies, episodes=5)
    gain = scores["ppo"]["return"] - scores["none"]["return"]
    np.testing.assert_allclose(gain, choices, rtol=1e-5)
