"""Environments shared out among devices, and stepped in blocks, take the very same course."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.wrappers import BatchAutoReset, environment_mesh, in_blocks
from medjax.wrappers.rows import CACHED_ROWS
from tests.train.probe_envs import Probe, ProbeParams

ENV, PARAMS = Probe("noisy"), ProbeParams(episode_decisions=4)


def course(env, params, num_envs, mesh, decisions):
    """All that `decisions` steps of a batch return."""
    batch = BatchAutoReset(env, num_envs, stagger=4, mesh=mesh)

    def step(state, key):
        actions = jax.random.randint(key, (num_envs,), 0, env.num_actions)
        obs, state, *rest = batch.step(key, state, actions, params)
        return state, (obs, *rest)

    _, state = jax.jit(batch.reset)(jax.random.key(0), params)
    keys = jax.random.split(jax.random.key(1), decisions)
    return jax.device_get(jax.jit(lambda state: jax.lax.scan(step, state, keys))(state))


@pytest.mark.parametrize("num_envs", [6, 2 * CACHED_ROWS + 2, 3 * CACHED_ROWS])
def test_devices_and_blocks_change_nothing(num_envs):
    """Two devices, blocks where the rows of one are too many, against one device; resets included."""
    assert len(jax.local_devices()) > 1
    alone = course(ENV, PARAMS, num_envs, None, 9)
    shared = course(ENV, PARAMS, num_envs, environment_mesh(num_envs, 2), 9)
    jax.tree.map(np.testing.assert_array_equal, alone, shared)


def test_devices_change_nothing_on_the_highway():
    """The same of the real environment to rounding, which depends on the shapes that XLA compiles for."""
    env, params = medjax.make("paper", episode_decisions=3)
    alone = course(env, params, 4, None, 8)
    shared = course(env, params, 4, environment_mesh(4, 2), 8)
    _, _, _, truncated, _ = alone[1]
    assert truncated.any()  # so resets are among it
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), alone[1], shared[1]
    )


@pytest.mark.parametrize("count", [5, CACHED_ROWS, 4 * CACHED_ROWS, 2 * CACHED_ROWS + 1])
def test_blocks_are_put_together_in_order(count):
    """Whatever the number of rows, for trees of several arguments."""
    rows = jnp.arange(count), {"b": jnp.ones((count, 3))}
    got = in_blocks(lambda a, tree: {"sum": a[:, None] + tree["b"]}, *rows)
    np.testing.assert_array_equal(got["sum"], np.arange(count)[:, None] + np.ones((count, 3)))


def test_mesh_takes_what_divides():
    """By itself as many devices as divide the environments; asked for more than it can, it refuses."""
    devices = len(jax.local_devices())
    assert environment_mesh(12 * devices).size == devices
    assert environment_mesh(1).size == 1
    with pytest.raises(ValueError, match=f"num_devices is {devices + 1}, allowed: 0 to {devices}"):
        environment_mesh(12, devices + 1)
    with pytest.raises(ValueError, match="num_devices is 2, allowed: a divisor of 7"):
        environment_mesh(7, 2)
