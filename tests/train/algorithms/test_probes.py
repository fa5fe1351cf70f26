"""The learner solves environments whose values and best policies are known."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.networks import apply_policy, build_network
from train.algorithms.ppo.learner import make_train
from train.settings import MOST_PER_CALL, TrainConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

GAMMA = 0.9
BASE = {
    "num_envs": 16,
    "num_minibatches": 2,
    "rollout_length": 8,
    "hidden": (16,),
    "activation": "tanh",
    "decide_every": 1,
    "initial_wait": 0.5,
    "gae_lambda": 0.97,
    "gamma": GAMMA,
    "normalize_rewards": False,
    "learning_rate": 1e-2,
}


def learn(env, updates, params=None, **changes):
    """Weights after `updates`, the network and the metrics."""
    params = params or ProbeParams()
    steps = BASE["num_envs"] * BASE["rollout_length"] * updates
    config = TrainConfig(**(BASE | {"total_timesteps": steps} | changes))
    programs = make_train(env, params, config)
    state = programs.init(jax.random.key(3), params)
    state, metrics = programs.run(state, params, jnp.int32(updates))
    return state, build_network(env, config), metrics


def value_and_probs(state, network, env, obs):
    obs = jnp.asarray(obs, jnp.float32)
    mask = env.action_mask(None, None)
    policy, value = apply_policy(
        network, state.weights, obs, jnp.broadcast_to(mask, (len(obs), env.num_actions))
    )
    return np.asarray(value), np.asarray(policy.probs)


def test_time_limit_is_bootstrapped():
    """Reward 1 for ever, cut every 5 decisions by a clock that the agent does not see: V = 1 / (1 - gamma)."""
    env = Probe("constant_truncated")
    state, network, _ = learn(env, 250, bootstrap_timeouts=True)
    value, _ = value_and_probs(state, network, env, [[0.0, 0.0]])
    assert value[0] == pytest.approx(1.0 / (1.0 - GAMMA), rel=0.01)


@pytest.mark.parametrize("kind", ["constant_terminated", "timed"])
def test_an_end_that_is_seen_coming_is_not_bootstrapped(kind):
    """A termination, and the time limit of an agent that sees the clock."""
    env = Probe(kind)
    state, network, _ = learn(env, 300, stagger=False)
    value, _ = value_and_probs(state, network, env, [[float(t), 0.0] for t in range(5)])
    expected = [(1.0 - GAMMA ** (5 - t)) / (1.0 - GAMMA) for t in range(5)]
    np.testing.assert_allclose(value, expected, rtol=0.02)


def test_credit_over_two_steps():
    env = Probe("two_step")
    state, network, _ = learn(env, 200, stagger=False)
    value, _ = value_and_probs(state, network, env, [[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(value, [GAMMA, 1.0], atol=0.02)


@pytest.mark.parametrize("kind", ["follow", "masked"])
def test_action_follows_the_cue_and_never_what_is_forbidden(kind):
    env = Probe(kind, num_actions=3 if kind == "masked" else 2)
    state, network, metrics = learn(env, 100, entropy_coef=0.0)
    value, probs = value_and_probs(state, network, env, [[-1.0, 0.0], [1.0, 0.0]])
    assert probs[0, 0] > 0.99
    assert probs[1, 1] > 0.99
    np.testing.assert_allclose(value, 1.0, atol=0.03)
    returns = np.asarray(metrics["episode_return"])[:100]
    assert returns.max() <= 1.0  # the forbidden action pays 10
    assert returns[-1] > 0.97
    if kind == "masked":
        np.testing.assert_array_equal(probs[:, 2], 0.0)


def test_scaled_rewards_give_scaled_values():
    """The same value in units of the return's spread, whatever the reward's size."""
    values = []
    for size in (1.0, 1000.0):
        env, params = Probe("constant_truncated"), ProbeParams(reward=size)
        state, network, _ = learn(env, 60, params, normalize_rewards=True)
        value, _ = value_and_probs(state, network, env, [[0.0, 0.0]])
        values.append(value[0])
    assert values[0] == pytest.approx(values[1], rel=1e-3)


def test_seeds_are_independent():
    env, params = Probe("noisy"), ProbeParams()
    config = TrainConfig(**(BASE | {"num_seeds": 2}))
    programs = make_train(env, params, config)
    state, metrics = programs.run(programs.init(jax.random.key(0), params), params, jnp.int32(2))
    assert metrics["loss"].shape == (2, MOST_PER_CALL)
    first, second = metrics["loss"][:, :2]
    assert (first != second).all()
    assert state.update.shape == (2,)


def test_one_program_serves_all_chunks_and_these_do_not_change_the_result():
    env, params = Probe("noisy"), ProbeParams()
    steps = BASE["num_envs"] * BASE["rollout_length"] * 6
    config = TrainConfig(**(BASE | {"total_timesteps": steps}))
    programs = make_train(env, params, config)
    ends, run = [], None
    for chunks in ((6,), (1, 2, 3)):
        state = programs.init(jax.random.key(0), params)
        # Compiled ahead of time: a call that this program does not fit would fail.
        run = run or programs.run.lower(state, params, jnp.int32(1)).compile()
        rates = []
        for count in chunks:
            state, metrics = run(state, params, jnp.int32(count))
            assert np.isfinite(metrics["loss"][:count]).all()
            assert np.isnan(metrics["loss"][count:]).all()
            rates += metrics["learning_rate"][:count].tolist()
        assert int(state.update) == 6
        np.testing.assert_allclose(rates, [1e-2 * (1 - n / 6) for n in range(6)], rtol=1e-5)
        ends.append(state.weights)
    chex.assert_trees_all_equal(*ends)


def test_the_number_of_devices_changes_rounding_only():
    """The same start, lots and noise on one device and on two: all metrics and weights agree."""
    env, params = Probe("noisy"), ProbeParams()
    ends = []
    for num_devices in (1, 2):
        config = TrainConfig(**(BASE | {"num_devices": num_devices}))
        programs = make_train(env, params, config)
        state = programs.init(jax.random.key(0), params)
        assert len(state.rollout.obs.sharding.device_set) == num_devices
        state, metrics = programs.run(state, params, jnp.int32(3))
        ends.append(jax.device_get((state.weights, state.rollout.obs, metrics)))
    chex.assert_trees_all_close(*ends, rtol=1e-3, atol=1e-4)
