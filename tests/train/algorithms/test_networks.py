"""The network for sets of vehicles: what order and empty slots must not change; and the masked policy."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env.observation import FlatObservation
from medjax.errors import InputError
from train.algorithms.environments import make_environment
from train.algorithms.networks import (
    PolicyWeights,
    apply_policy,
    apply_value,
    build_network,
    masked_categorical,
)
from train.algorithms.normalization import init_stats
from train.algorithms.policy_prior import prior_logits
from train.algorithms.ppo.settings import PPOConfig

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 3, "num_evs": 5, "num_gas": 12}
CONFIG = PPOConfig(network="sets", observation="flat", hidden=(16,), encoder=(8, 8))


@pytest.fixture(scope="module")
def scene():
    """A small environment, its parameters, and observations and states of three roads in mid-traffic."""
    env, params = medjax.make("paper", **SMALL)
    keys = jax.random.split(jax.random.key(1), 3)
    return env, params, *jax.jit(jax.vmap(env.reset, (0, None)))(keys, params)


@pytest.fixture(scope="module")
def apply(scene):
    """`obs -> logits, values` of the network for sets, with random weights."""
    env, _, obs, _ = scene
    network = build_network(env, CONFIG)
    weights = network.init(jax.random.key(0), obs)
    # The last layer begins near zero, where much would look alike.
    weights = jax.tree.map(lambda w: jax.random.normal(jax.random.key(w.size), w.shape), weights)
    return lambda obs, network=network: network.apply(weights, obs)


def joined(meds, evs, clock):
    """The inverse of `FlatObservation.split`."""
    return jnp.concatenate([meds.reshape(3, -1), evs.reshape(3, -1), clock], axis=-1)


def assert_close(found, expected):
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "config", [CONFIG, PPOConfig(hidden=(4,), rule_sharpness=4.0)], ids=["sets", "mlp"]
)
def test_an_observation_of_another_size_is_refused(config):
    """One feature would be broadcast to all without a word."""
    env, params = medjax.make("paper", observation=config.observation, **SMALL)
    (size,) = env.observation_space(params).shape
    network, obs = build_network(env, config), jnp.zeros((1, size))
    weights = PolicyWeights(network.init(jax.random.key(0), obs), init_stats((size,)))
    mask = jnp.ones((2, env.num_actions), bool)
    for wrong in (jnp.zeros((2, 1)), jnp.zeros((2, size + 1))):
        words = rf"\(2, {wrong.shape[1]}\), allowed: {size} features"
        with pytest.raises(InputError, match=words):
            apply_policy(network, weights, wrong, mask)
        with pytest.raises(InputError, match=words):
            apply_value(network, weights, wrong)


def test_what_is_learned_at_one_ramp_holds_at_all():
    """The shared network alone: ramps whose features change places change logits, and sending waits for nobody."""
    config = PPOConfig(hidden=(4,), policy_prior="wait")
    assert config.network == "ramps"
    env, params = medjax.make("paper", observation=config.observation, **SMALL)
    network, plain = (
        build_network(env, config),
        build_network(env, PPOConfig(network="mlp", policy_prior="wait")),
    )
    _, state = env.reset(jax.random.key(0), params)
    obs = env.get_obs(state, params)
    weights = network.init(jax.random.key(1), obs)
    assert "ramp_torso" not in plain.init(jax.random.key(1), obs)["params"]
    # Only the shared network speaks, and it does not read which ramp it is.
    inner = jax.tree.map(lambda leaf: leaf, weights["params"])
    inner["logits_head"] = jax.tree.map(jnp.zeros_like, inner["logits_head"])
    kernel = inner["ramp_torso"]["Dense_0"]["kernel"]
    ramps = env.config.num_ramps
    inner["ramp_torso"]["Dense_0"]["kernel"] = kernel.at[-ramps:].set(0.0)
    columns = len(obs) - 2 * env.observation.clock_nodes - 4 - 6 * ramps + np.arange(6 * ramps)
    rng = np.random.default_rng(0)
    features = rng.uniform(size=(6, ramps)).astype(np.float32)
    order = rng.permutation(ramps)
    prior = prior_logits(env, config)(obs)

    def learned(of_ramps):
        given = obs.at[columns].set(of_ramps.ravel())
        return network.apply({"params": inner}, given)[0] - prior

    first, second = learned(features), learned(features[:, order])
    assert first[0] == second[0] == 0.0
    assert len({float(logit) for logit in first}) == 1 + ramps
    np.testing.assert_allclose(second[1:], first[1:][order], atol=1e-6)


def test_split_is_the_structured_observation(scene):
    env, params, obs, states = scene
    seen = jax.vmap(env.observe, (0, None))(states, params)
    for index in (slice(None), 1):  # a batch, and one road
        parts = FlatObservation().split(obs[index], env.config)
        for part, expected in zip(parts, (seen.meds, seen.evs, seen.clock), strict=True):
            np.testing.assert_array_equal(part, expected[index])
    no_clock = FlatObservation(include_clock=False)
    assert no_clock.split(obs[:, :-4], env.config)[2].shape == (3, 0)
    assert no_clock.split(obs[0, :-4], env.config)[2].shape == (0,)


def test_the_order_of_slots_does_not_matter_but_vehicles_do(apply, scene):
    env, _, obs, _ = scene
    meds, evs, clock = FlatObservation().split(obs, env.config)
    other = joined(meds[:, ::-1], jnp.roll(evs, 2, axis=1), clock)
    assert not np.array_equal(other, obs)
    assert_close(apply(other), apply(obs))
    fewer = apply(joined(meds, evs.at[:, 0].set(0.0), clock))
    there = np.asarray(jnp.any(evs[:, 0] != 0.0, axis=-1))
    assert there.any()
    assert (np.abs(fewer[1] - apply(obs)[1])[there] > 1e-3).all()


def test_empty_slots_change_nothing(apply, scene):
    """The same weights on a road with more slots: no vehicle, no difference."""
    env, _, obs, _ = scene
    meds, evs, clock = FlatObservation().split(obs, env.config)
    wide, _ = medjax.make("paper", **(SMALL | {"num_evs": 9}))
    more = jnp.concatenate([evs, jnp.zeros((3, 4, evs.shape[-1]))], axis=1)
    assert_close(apply(joined(meds, more, clock), build_network(wide, CONFIG)), apply(obs))


def test_only_the_raw_flat_observation_has_rows():
    env, _ = medjax.make("paper", observation="profile", **SMALL)
    with pytest.raises(ValueError, match="network is 'sets' and observation is 'profile'"):
        build_network(env, PPOConfig(network="sets"))
    with pytest.raises(ValueError, match="normalize_observations is True, allowed: False"):
        dataclasses.replace(CONFIG, normalize_observations=True)
    with pytest.raises(
        ValueError, match="policy_prior is 'rule' and normalize_observations is True"
    ):
        PPOConfig(observation="profile", normalize_observations=True)
    assert PPOConfig(policy_prior="wait", normalize_observations=True).normalize_observations


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
    keys = jax.random.split(jax.random.key(0), 200)
    samples = jax.vmap(lambda key: policy.sample(seed=key))(keys)
    assert (samples[:, 0] < 2).all()
    assert (samples[:, 1] == 0).all()

    def total(logits):
        policy = masked_categorical(logits, mask)
        return (policy.log_prob(jnp.array([0, 0])) + policy.entropy()).sum()

    gradient = jax.grad(total)(logits)
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(gradient[~mask], 0.0)


@pytest.mark.parametrize(
    "how", [{}, {"network": "sets", "observation": "flat", "encoder": (8,)}, {"agents": "mappo"}]
)
def test_a_sample_of_zeros_has_finite_gradients(how):
    """The padding of a block of samples: nobody is seen, nothing is allowed, and its weight 0 would not hide a NaN."""
    config = PPOConfig(hidden=(16,), rule_sharpness=4.0, **how)
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
