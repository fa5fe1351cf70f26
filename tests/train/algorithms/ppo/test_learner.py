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


def learner(env, params, updates, **changes):
    """A function of parameters: trains, and returns `(obs, mask) -> policy, value` and the metrics; one program."""
    steps = BASE["num_envs"] * BASE["rollout_length"] * updates
    config = PPOConfig(**(BASE | {"total_timesteps": steps} | changes))
    programs, network = make_train(env, params, config), build_network(env, config)

    def learn(params):
        state = programs.init(jax.random.key(3), params)
        state, metrics = programs.run(state, params, jnp.int32(updates))
        return lambda obs, mask: apply_policy(network, state.weights, obs, mask), metrics

    return learn


def value_and_probs(act, env, obs):
    """Values `(rows,)` and probabilities `(rows, num_actions)` as NumPy arrays."""
    mask = jnp.broadcast_to(env.action_mask(None, None), (len(obs), env.num_actions))
    policy, value = act(jnp.asarray(obs, jnp.float32), mask)
    return np.asarray(value), np.asarray(policy.probs)


@pytest.mark.thorough
def test_time_limit_is_bootstrapped():
    """Reward 1 for ever, cut every 5 decisions by a clock that the agent does not see: V = 1 / (1 - gamma)."""
    env, params = Probe("constant_truncated"), ProbeParams()
    act, _ = learner(env, params, 250, bootstrap_timeouts=True)(params)
    value, _ = value_and_probs(act, env, [[0.0, 0.0]])
    assert value[0] == pytest.approx(1.0 / (1.0 - GAMMA), rel=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["constant_terminated", "timed"])
def test_a_foreseeable_end_is_not_bootstrapped(kind):
    """A termination, and the time limit of an agent that sees the clock."""
    env, params = Probe(kind), ProbeParams()
    act, _ = learner(env, params, 300, stagger=False)(params)
    value, _ = value_and_probs(act, env, [[float(t), 0.0] for t in range(5)])
    expected = [(1.0 - GAMMA ** (5 - t)) / (1.0 - GAMMA) for t in range(5)]
    np.testing.assert_allclose(value, expected, rtol=0.02)


@pytest.mark.thorough
def test_credit_over_two_steps():
    env, params = Probe("two_step"), ProbeParams()
    act, _ = learner(env, params, 200, stagger=False)(params)
    value, _ = value_and_probs(act, env, [[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_allclose(value, [GAMMA, 1.0], atol=0.02)


@pytest.mark.parametrize("kind", ["follow", "masked"])
def test_actions_follow_the_cue_and_never_the_forbidden_one(kind):
    env, params = Probe(kind, num_actions=3 if kind == "masked" else 2), ProbeParams()
    act, metrics = learner(env, params, 100, entropy_coef=0.0)(params)
    value, probs = value_and_probs(act, env, [[-1.0, 0.0], [1.0, 0.0]])
    assert probs[0, 0] > 0.99
    assert probs[1, 1] > 0.99
    np.testing.assert_array_equal(probs[:, 2:], 0.0)
    np.testing.assert_allclose(value, 1.0, atol=0.03)
    returns = np.asarray(metrics["episode_return"])[:100]
    assert returns.max() <= 1.0  # the forbidden action pays 10
    assert returns[-1] > 0.97


@pytest.mark.parametrize(
    ("planned", "updates", "expected"),
    [
        (100, 0, 1.0),
        (100, 30, 8.0 ** (3 / 7)),
        (100, 70, 8.0),
        (100, 90, 8.0),
        (10, 10, 1.04**10),  # by at most 4 % an update
    ],
)
def test_logits_sharpen_until_seven_tenths_of_the_updates(planned, updates, expected):
    """In equal ratios to a factor of 8, if updates suffice; probabilities are those of the logits, by NumPy."""
    env, params = Probe("follow", num_actions=2), ProbeParams()
    steps = BASE["num_envs"] * BASE["rollout_length"] * planned
    config = PPOConfig(**BASE, total_timesteps=steps, sharpening=8.0)
    programs, network = make_train(env, params, config), build_network(env, config)
    state = programs.init(jax.random.key(3), params)
    weights = programs.run(state, params, jnp.int32(updates))[0].weights
    assert float(weights.sharpness) == pytest.approx(expected, rel=1e-5)
    obs, mask = jnp.array([[1.0, 0.0], [-1.0, 0.0]]), jnp.ones((2, 2), bool)
    policy, _ = apply_policy(network, weights, obs, mask)
    logits = np.asarray(network.apply(weights.params, obs)[0], np.float64) * expected
    probs = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(policy.probs, probs, rtol=1e-4)


def test_scaled_rewards_give_scaled_values():
    """The same value in units of the return's spread, whatever the reward's size."""
    env = Probe("constant_truncated")
    learn = learner(env, ProbeParams(), 60, normalize_rewards=True)
    small, large = (
        value_and_probs(learn(ProbeParams(reward=size))[0], env, [[0.0, 0.0]])[0][0]
        for size in (1.0, 1000.0)
    )
    assert small == pytest.approx(large, rel=1e-3)


@pytest.mark.parametrize(("num_envs", "num_minibatches"), [(240, 16), (480, 16), (256, 256)])
def test_any_divisor_is_traced(num_envs, num_minibatches):
    """Blocks of about 128 environments would split groups that play the same episodes."""
    env, params = Probe("timed"), ProbeParams()
    sizes = {"num_envs": num_envs, "num_minibatches": num_minibatches, "num_devices": 1}
    config = PPOConfig(**(BASE | sizes | {"total_timesteps": 10**6}))
    programs = make_train(env, params, config)
    state = shapes_of(programs, params, config)
    state, _ = jax.eval_shape(programs.run, state, params, jnp.int32(1))
    assert state.rollout.obs.shape[0] == num_envs
