"""Who is in which minibatch."""

import jax
import jax.numpy as jnp

from train.algorithms.minibatches import split_environments


def test_each_sample_is_in_exactly_one_minibatch():
    steps, envs, parts = 3, 12, 4
    samples = {
        "id": jnp.arange(steps * envs).reshape(envs, steps),
        "x": jnp.zeros((envs, steps, 5)),
    }
    dealt = split_environments(jax.random.key(1), samples, parts)
    assert dealt["id"].shape == (parts, envs // parts, steps)
    assert dealt["x"].shape == (parts, envs // parts, steps, 5)
    assert sorted(dealt["id"].ravel().tolist()) == list(range(steps * envs))
    # Whole environments stay together.
    assert (dealt["id"][..., 1] - dealt["id"][..., 0] == 1).all()
    other = split_environments(jax.random.key(2), samples, parts)
    assert (other["id"] != dealt["id"]).any()
