"""The split of samples into minibatches, and gradient steps that devices share."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from medjax.numerics.devices import environment_mesh
from train.algorithms import minibatches
from train.algorithms.minibatches import run_epochs, split_environments


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


def fit(num_devices, teaches=None):
    """A function that fits a line by epochs of gradient steps on so many devices, and its samples.

    Three minibatches of 8 environments, of 2 steps each.
    """
    x = jax.random.normal(jax.random.key(0), (3, 8, 2, 5))
    y = x @ jnp.arange(5.0) + 2.0
    start = {"slope": jnp.zeros(5), "offset": jnp.zeros(())}
    optimizer = optax.adam(0.1)
    teaches = jnp.ones((3, 8, 2), bool) if teaches is None else teaches
    samples = {"x": x, "y": y, "there": jnp.ones((3, 8, 2))}

    def loss(params, x, batch):
        error = x @ params["slope"] + params["offset"] * batch["there"] - batch["y"]
        return jnp.mean(jnp.square(error)), {"error": jnp.mean(jnp.abs(error))}

    mesh = environment_mesh(8, num_devices)
    began = start, optimizer.init(start)
    numbers = split_environments(jax.random.key(1), jnp.arange(24, dtype=jnp.int32), 3)
    assert (numbers[0] % 3 > 0).any()  # drawn, not the first of each three

    @jax.jit
    def run(batches):
        teaches, small = batches[0], dict(batches[1])
        x = small.pop("x")
        seen = jnp.zeros((2, 24, 5)).at[:, numbers].set(jnp.moveaxis(x, 2, 0))  # as acted
        return run_epochs(loss, optimizer, began, seen, (numbers, teaches, small), 60, mesh)

    return run, (teaches, samples)


def assert_close(a, b):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6), a, b)


@pytest.mark.thorough
def test_devices_that_share_a_minibatch_take_the_same_steps_as_one():
    alone, shared = ([*run(batches)] for run, batches in map(fit, (1, 2)))
    assert_close(alone, shared)
    np.testing.assert_allclose(shared[0]["slope"], np.arange(5.0), atol=0.3)


@pytest.mark.parametrize("num_devices", [1, 2])
def test_only_samples_that_teach_are_read_a_block_at_a_time(monkeypatch, num_devices):
    """As if the others were zeros, whichever device has them; here they are NaN."""
    # All on the first of two devices.
    teaches = jnp.arange(48).reshape(3, 8, 2) % 16 < jnp.asarray([5, 6])
    run, (_, samples) = fit(num_devices, teaches)
    spread = {name: teaches[..., None] if name == "x" else teaches for name in samples}
    zeros, unread = (
        {name: jnp.where(spread[name], leaf, other) for name, leaf in samples.items()}
        for other in (0.0, jnp.nan)
    )
    whole = run((jnp.ones_like(teaches), zeros))
    monkeypatch.setattr(minibatches, "ROWS_AT_ONCE", 2)
    blocks, _ = fit(num_devices, teaches)
    assert_close([*whole], [*blocks((teaches, unread))])


def test_a_gradient_step_is_one_message():
    """Gradients of all arrays and all scalars together, because each message waits for all processes."""
    run, batches = fit(2)
    program = run.lower(batches).compile().as_text()
    assert len(re.findall(r" all-reduce(?:-start)?\(", program)) == 1
