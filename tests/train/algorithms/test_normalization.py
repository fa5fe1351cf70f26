"""Running moments against NumPy over all samples at once."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from train.algorithms.normalization import init_stats, normalize, scale_reward, update_stats


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    offset=st.sampled_from([0.0, 3.0, -1000.0]),
    scale=st.sampled_from([0.1, 1.0, 50.0]),
)
def test_moments_of_batches_are_those_of_everything(seed, offset, scale):
    rng = np.random.default_rng(seed)
    batches = [offset + scale * rng.normal(size=(4, 6, 3)) for _ in range(5)]
    stats = init_stats((3,))
    for batch in batches:
        stats = update_stats(stats, jnp.asarray(batch, jnp.float32))
    everything = np.float32(batches).reshape(-1, 3).astype(float)
    assert stats.count == 120
    np.testing.assert_allclose(stats.mean, everything.mean(0), rtol=1e-5, atol=1e-4 * scale)
    np.testing.assert_allclose(stats.var, everything.var(0), rtol=2e-3 if offset < -1 else 1e-4)


def test_without_samples_data_stay_as_they_are():
    x = jnp.array([[1.0, -2.0]])
    np.testing.assert_array_equal(normalize(init_stats((2,)), x), x)
    assert scale_reward(init_stats(), jnp.float32(3.0)) == 3.0


def test_normalize_equals_numpy_and_clips():
    x = np.random.default_rng(0).normal(5.0, 3.0, (200, 4)).astype(np.float32)
    stats = update_stats(init_stats((4,)), jnp.asarray(x))
    np.testing.assert_allclose(normalize(stats, x), (x - x.mean(0)) / x.std(0), atol=1e-4)
    assert normalize(stats, jnp.full((4,), 1e6)).tolist() == [10.0] * 4
    assert normalize(stats, jnp.full((4,), -1e6), clip=2.0).tolist() == [-2.0] * 4


def test_a_constant_is_not_blown_up():
    stats = update_stats(init_stats((1,)), jnp.full((10, 1), 3.0))
    assert normalize(stats, jnp.array([3.0])) == 0.0
    assert abs(normalize(stats, jnp.array([3.001]))[0]) < 0.2
    never_paid = update_stats(init_stats(), jnp.zeros(8))
    assert np.isfinite(scale_reward(never_paid, jnp.float32(1.0)))


def test_rewards_are_scaled_not_shifted():
    sums = np.random.default_rng(1).normal(100.0, 4.0, (50, 8))
    stats = update_stats(init_stats(), jnp.asarray(sums, jnp.float32))
    reward = jnp.array([-3.0, 0.0, 3.0])
    scaled = scale_reward(stats, reward)
    np.testing.assert_allclose(scaled, reward / sums.std(), rtol=1e-3)
    assert scaled[1] == 0.0
    assert scaled[0] == -scaled[2]
