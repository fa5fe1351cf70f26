"""The network for sets of vehicles: what order and empty slots must not change; and the masked policy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.observation import FlatObservation
from medjax.env.wrapper import Wrapper
from medjax.errors import InputError
from medjax.policies.rules import BASELINES
from train.algorithms.environments import make_environment
from train.algorithms.networks import (
    PolicyWeights,
    apply_policy,
    apply_value,
    build_network,
    masked_categorical,
)
from train.algorithms.normalization import init_stats
from train.algorithms.ppo.settings import PPOConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 3, "num_evs": 5, "num_gas": 12}
CONFIG = PPOConfig(network="sets", observation="flat", hidden=(16,), encoder=(8, 8))


@dataclasses.dataclass(frozen=True)
class MoreActions(Wrapper):
    """Somebody's own, with an action more than there are ramps."""

    @property
    def num_actions(self):
        return self.env.num_actions + 1


def test_other_actions_than_ramps_begin_without_the_rule():
    """A wrapper with another number of actions, by default; the rule begins where they are the ramps."""
    env, params = medjax.make("paper", observation="profile", **SMALL)
    obs = jnp.ones((1, *env.observation_space(params).shape))
    for world, even in ((MoreActions(env), True), (env, False)):
        built = build_network(world, PPOConfig(hidden=(4,)))
        logits, _ = built.apply(built.init(jax.random.key(0), obs), obs)
        assert logits.shape == (1, world.num_actions)
        assert (np.ptp(logits[0, 1:]) < 0.1) == even


def test_an_observation_of_another_size_is_refused():
    """One that is as wide as 1 would be spread over all features without a word."""
    env, params = medjax.make("paper", observation="profile", **SMALL)
    (size,) = env.observation_space(params).shape
    built = build_network(env, PPOConfig(hidden=(4,)))
    weights = PolicyWeights(
        built.init(jax.random.key(0), jnp.zeros((1, size))), init_stats((size,))
    )
    mask = jnp.ones((2, env.num_actions), bool)
    for wrong in (1, size + 1):
        obs = jnp.zeros((2, wrong))
        for call in (
            lambda obs=obs: apply_policy(built, weights, obs, mask),
            lambda obs=obs: apply_value(built, weights, obs),
        ):
            with pytest.raises(InputError, match=rf"\(2, {wrong}\), allowed: {size} features"):
                call()


@pytest.fixture(scope="module")
def network():
    """`(weights, obs) -> logits and values`, and random weights."""
    env, params = medjax.make("paper", **SMALL)
    built = build_network(env, CONFIG)
    obs = jnp.zeros((1, *env.observation_space(params).shape))
    weights = built.init(jax.random.key(0), obs)
    # The last layer begins near zero, where much would look alike.
    weights = jax.tree.map(lambda w: jax.random.normal(jax.random.key(w.size), w.shape), weights)
    return jax.jit(built.apply), weights


@pytest.fixture(scope="module")
def scene():
    """Observations of three roads in mid-traffic, and the environment's configuration."""
    env, params = medjax.make("paper", **SMALL)
    obs, _ = jax.jit(jax.vmap(env.reset, (0, None)))(jax.random.split(jax.random.key(1), 3), params)
    return obs, env.config


def joined(meds, evs, clock):
    """The inverse of `FlatObservation.split`."""
    return jnp.concatenate([meds.reshape(3, -1), evs.reshape(3, -1), clock], axis=-1)


def test_split_is_the_structured_observation():
    env, params = medjax.make("paper", **SMALL)
    obs, state = jax.jit(env.reset)(jax.random.key(2), params)
    seen = env.observe(state, params)
    meds, evs, clock = FlatObservation().split(obs, env.config)
    np.testing.assert_array_equal(meds, seen.meds)
    np.testing.assert_array_equal(evs, seen.evs)
    np.testing.assert_array_equal(clock, seen.clock)
    assert FlatObservation(include_clock=False).split(obs[:-4], env.config)[2].shape == (0,)


def test_the_order_of_slots_does_not_matter_and_vehicles_do(network, scene):
    apply, weights = network
    obs, config = scene
    meds, evs, clock = FlatObservation().split(obs, config)
    logits, value = apply(weights, obs)
    other = joined(meds[:, ::-1], jnp.roll(evs, 2, axis=1), clock)
    assert not np.array_equal(other, obs)
    shuffled = apply(weights, other)
    np.testing.assert_allclose(shuffled[0], logits, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(shuffled[1], value, rtol=1e-4, atol=1e-4)
    fewer = apply(weights, joined(meds, evs.at[:, 0].set(0.0), clock))
    there = np.asarray(jnp.any(evs[:, 0] != 0.0, axis=-1))
    assert there.any()
    assert (np.abs(fewer[1] - value)[there] > 1e-3).all()


def test_empty_slots_change_nothing(network, scene):
    """The same weights on a road with room for more: no vehicle, no difference."""
    apply, weights = network
    obs, config = scene
    meds, evs, clock = FlatObservation().split(obs, config)
    env, _ = medjax.make("paper", **(SMALL | {"num_evs": 9}))
    wider = jnp.concatenate([evs, jnp.zeros((3, 4, evs.shape[-1]))], axis=1)
    logits, value = build_network(env, CONFIG).apply(weights, joined(meds, wider, clock))
    np.testing.assert_allclose(logits, apply(weights, obs)[0], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(value, apply(weights, obs)[1], rtol=1e-4, atol=1e-4)


def test_only_the_flat_observation_has_rows():
    env, _ = medjax.make("paper", observation="profile", **SMALL)
    with pytest.raises(ValueError, match="network is 'sets' and observation is 'profile'"):
        build_network(env, PPOConfig(network="sets"))
    env, _ = medjax.make("paper", **SMALL)
    with pytest.raises(ValueError, match="normalize_observations is True, allowed: False"):
        build_network(env, dataclasses.replace(CONFIG, normalize_observations=True))
    with pytest.raises(ValueError, match="start is 'rule' and normalize_observations is True"):
        PPOConfig(observation="profile", normalize_observations=True)
    assert PPOConfig(start="wait", normalize_observations=True).normalize_observations


def test_masked_distribution_is_the_softmax_of_the_allowed():
    logits = jnp.array([[1.0, 2.0, 3.0], [0.5, 0.0, -1.0]])
    mask = jnp.array([[True, True, False], [True, False, False]])
    policy = masked_categorical(logits, mask)
    expected = np.exp([1.0, 2.0]) / np.exp([1.0, 2.0]).sum()
    np.testing.assert_allclose(policy.probs[0], [*expected, 0.0], rtol=1e-6)
    entropy = policy.entropy()
    assert entropy[0] == pytest.approx(-(expected * np.log(expected)).sum(), rel=1e-5)
    assert entropy[1] == 0.0
    assert (policy.mode() == jnp.array([1, 0])).all()
    samples = jax.vmap(lambda key: policy.sample(seed=key))(
        jax.random.split(jax.random.key(0), 200)
    )
    assert (samples[:, 0] < 2).all()
    assert (samples[:, 1] == 0).all()
    gradient = jax.grad(
        lambda x: (
            masked_categorical(x, mask).log_prob(jnp.array([0, 0]))
            + masked_categorical(x, mask).entropy()
        ).sum()
    )(logits)
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(gradient[~mask], 0.0)


def test_starts_as_the_rule_it_begins_from():
    """Before training the most probable action is that of `budgeted`, in all but ties that the last layer decides."""
    env, params = medjax.make("paper", observation="profile")
    network = build_network(env, PPOConfig(hidden=(16,)))
    policy, rule = BASELINES["budgeted"](env), BASELINES["random"](env)

    def play(state, key):
        obs, mask = env.get_obs(state, params), env.action_mask(state, params)
        act_key, step_key = jax.random.split(key)
        choice = policy(act_key, obs, state, params).action
        taken = rule(act_key, obs, state, params).action
        goes = jnp.where(jax.random.bernoulli(step_key, 0.1), taken, choice)
        return env.step_env(step_key, state, goes, params)[1], (obs, mask, choice)

    _, state = jax.jit(env.reset)(jax.random.key(3), params)
    keys = jax.random.split(jax.random.key(4), 400)
    obs, mask, expected = jax.jit(lambda state: jax.lax.scan(play, state, keys)[1])(state)
    weights = network.init(jax.random.key(0), obs)
    logits, _ = network.apply(weights, obs)
    mode = np.asarray(masked_categorical(logits, mask).mode())
    near = np.sort(np.asarray(jnp.where(mask, logits, -1e9)), axis=1)
    clear = near[:, -1] - near[:, -2] > 0.2
    np.testing.assert_array_equal(mode[clear], np.asarray(expected)[clear])
    assert (mode[clear] > 0).sum() >= 3
    assert clear.mean() > 0.8


@pytest.mark.parametrize("observation", ["profile", "flat"])
def test_or_waits_with_the_probability_that_is_asked_for(observation):
    """On a flat observation whatever `start` says: it does not tell what the rule goes by."""
    env, params = medjax.make("paper", observation=observation)
    start = {"profile": "wait", "flat": "rule"}[observation]
    network = build_network(env, PPOConfig(hidden=(16,), start=start, initial_wait=0.9))
    obs, state = jax.jit(env.reset)(jax.random.key(0), params)
    logits, _ = network.apply(network.init(jax.random.key(1), obs[None]), obs)
    probs = masked_categorical(logits, env.action_mask(state, params)).probs
    np.testing.assert_allclose(probs, [0.9, *[0.025] * 4], atol=0.01)


@pytest.mark.parametrize(
    "how", [{}, {"network": "sets", "observation": "flat"}, {"agents": "mappo"}]
)
def test_a_sample_of_zeros_has_finite_gradients(how):
    """As the gaps of a block of samples are: nobody is seen, and nothing is allowed; times their weight it is 0."""
    config = PPOConfig(hidden=(16,), encoder=(8,), **how)
    env, params = make_environment(config)
    network, nothing = build_network(env, config), jnp.zeros(env.observation_space(params).shape)
    weights = network.init(jax.random.key(0), nothing[None])

    @jax.jit
    @jax.grad
    def slope(given):
        logits, value = network.apply(given, nothing)
        policy = masked_categorical(logits, jnp.zeros(logits.shape, bool))
        zero = jnp.zeros(value.shape, jnp.int32)
        return jnp.sum(policy.log_prob(zero) + policy.entropy() + value)

    for leaf in jax.tree.leaves(slope(weights)):
        assert np.isfinite(leaf).all()
