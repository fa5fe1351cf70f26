"""The learner solves environments whose values and best policies are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.networks import apply_policy, build_network
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train, shapes_of

pytestmark = pytest.mark.usefixtures("quick_compiles")

GAMMA = 0.9
BASE = {
    "num_envs": 16,
    "num_minibatches": 2,
    "rollout_length": 8,
    "num_epochs": 4,
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
    config = PPOConfig(**(BASE | {"total_timesteps": steps} | changes))
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


@pytest.mark.parametrize(("num_envs", "num_minibatches"), [(240, 16), (480, 16), (256, 256)])
def test_whatever_divides_is_traced(num_envs, num_minibatches):
    """Numbers of environments of which blocks of some 128 would cut groups that meet the same episodes."""
    env, params = Probe("timed"), ProbeParams()
    sizes = {"num_envs": num_envs, "num_minibatches": num_minibatches, "num_devices": 1}
    config = PPOConfig(**(BASE | sizes | {"total_timesteps": 10**6}))
    programs = make_train(env, params, config)
    state = shapes_of(programs, params, config)
    state, _ = jax.eval_shape(programs.run, state, params, jnp.int32(1))
    assert state.rollout.obs.shape[0] == num_envs
