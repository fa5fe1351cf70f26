"""The ends of episodes in a rollout."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.wrappers import BatchAutoReset, EpisodeLog, TimeLimitAsEnd
from tests.train.probe_envs import Probe, ProbeParams
from train.algorithms.networks import PolicyWeights, apply_value, build_network
from train.algorithms.normalization import init_stats
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.rollout import Collector

pytestmark = pytest.mark.usefixtures("quick_compiles")

LENGTH, ENVS = 5, 16


@pytest.mark.parametrize("bootstrap_timeouts", [False, True])
def test_cut_episodes_are_always_bootstrapped_and_time_limits_on_request(bootstrap_timeouts):
    """First episodes are cut after 1 to 5 decisions; all others end by time after 5."""
    env, params = Probe("timed"), ProbeParams(episode_decisions=LENGTH)
    network = build_network(env, PPOConfig(hidden=(8,)))
    weights = PolicyWeights(network.init(jax.random.key(0), jnp.zeros((1, 2))), init_stats((2,)))
    limited = env if bootstrap_timeouts else TimeLimitAsEnd(env)
    batch = EpisodeLog(BatchAutoReset(limited, stagger=LENGTH))
    collector = Collector(batch, network, num_steps=12, gamma=0.9)
    state = collector.start(jax.random.split(jax.random.key(1), ENVS), params)
    keys = jax.random.split(jax.random.key(2), ENVS)
    _, trajectory, _, _ = collector.collect(weights, state, keys, params)

    seen = jnp.array([[float(time), 0.0] for time in range(LENGTH + 1)])
    values = np.asarray(apply_value(network, weights, seen))
    terminated, truncated, final_value = (
        np.asarray(part).T
        for part in (trajectory.terminated, trajectory.truncated, trajectory.final_value)
    )
    ends = terminated | truncated
    first = ends.argmax(axis=1)
    assert set(first) == set(range(LENGTH))
    for row, cut in enumerate(first):
        for end in np.flatnonzero(ends[row]):
            by_time = end > cut or cut == LENGTH - 1
            over = by_time and not bootstrap_timeouts
            assert terminated[row, end] == over
            time = LENGTH if by_time else cut + 1
            expected = 0.0 if over else values[time]
            np.testing.assert_allclose(final_value[row, end], expected, rtol=1e-5, atol=1e-6)
        assert (final_value[row, ~ends[row]] == 0.0).all()
