"""Environments on several devices and in blocks give the same bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.errors import InputError
from medjax.numerics.rows import CACHED_ROWS, rows_that_fit
from medjax.wrappers import BatchAutoReset, environment_mesh, in_blocks, on_devices
from tests.refusals import refused
from tests.train.probe_envs import Probe, ProbeParams

ENV, PARAMS = Probe("noisy"), ProbeParams(episode_decisions=4)
# A machine with one GPU has one device; of CPU devices tests/conftest.py makes two.
alone = jax.default_backend() != "cpu" and len(jax.local_devices()) < 2
two_devices = pytest.mark.skipif(alone, reason="needs two devices")


def course(env, params, num_envs, num_devices, decisions):
    """Everything that `decisions` steps return, and the last state; without devices in one batch."""
    batch = BatchAutoReset(env, stagger=4)

    def play(keys, params):
        def step(state, keys):
            actions = jax.vmap(lambda key: jax.random.randint(key, (), 0, env.num_actions))(keys)
            obs, state, *rest = batch.step(keys, state, actions, params)
            return state, (obs, *rest)

        keys = jax.vmap(lambda key: jax.random.split(key, decisions + 1), out_axes=1)(keys)
        _, state = batch.reset(keys[0], params)
        state, results = jax.lax.scan(step, state, keys[1:])
        return state, jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), results)

    shared = on_devices(environment_mesh(num_envs, num_devices), play) if num_devices else play
    keys = jax.random.split(jax.random.key(0), num_envs)
    return jax.device_get(jax.jit(shared)(keys, params))


@two_devices
@pytest.mark.thorough
@pytest.mark.parametrize("num_envs", [6, 2 * CACHED_ROWS + 2, 3 * CACHED_ROWS])
def test_devices_and_blocks_change_nothing(num_envs):
    """Two devices, blocks where the rows of one are too many, against one device; resets included."""
    alone = course(ENV, PARAMS, num_envs, None, 9)
    shared = course(ENV, PARAMS, num_envs, 2, 9)
    jax.tree.map(np.testing.assert_array_equal, alone, shared)


@pytest.mark.parametrize("count", [5, CACHED_ROWS, 4 * CACHED_ROWS, 2 * CACHED_ROWS + 1])
def test_blocks_are_joined_in_order(count):
    rows = jnp.arange(count), {"b": jnp.ones((count, 3))}
    got = in_blocks(lambda pair: {"sum": pair[0][:, None] + pair[1]["b"]}, rows)
    np.testing.assert_array_equal(got["sum"], np.arange(count)[:, None] + np.ones((count, 3)))


@two_devices
@pytest.mark.parametrize("count", [6, 4 * CACHED_ROWS])
def test_rows_may_be_on_any_axis_of_results(count):
    """First, or in a tree after time."""

    def play(rows, same):
        steps = jnp.arange(3)[:, None] * same + rows
        return rows, {"a": steps, "b": steps[..., None] + jnp.arange(2)}

    rows = jnp.arange(count)
    first, later = on_devices(environment_mesh(count, 2), play, out_axes=(0, 1))(rows, 1000)
    jax.tree.map(np.testing.assert_array_equal, (first, later), play(rows, 1000))


@pytest.mark.parametrize("count", [4 * CACHED_ROWS, 2 * CACHED_ROWS + 16, 240])
def test_groups_stay_together(count):
    """Blocks do not split a group of 16 rows."""

    def first(rows, _):
        return jnp.repeat(rows.reshape(-1, 16)[:, 0], 16)

    rows = jnp.arange(count)
    got = on_devices(environment_mesh(count // 16, 1), first, group=16)(rows, None)
    np.testing.assert_array_equal(got, rows - rows % 16)


@two_devices
def test_mesh_takes_the_most_devices_that_divide_the_environments():
    devices = len(jax.local_devices())
    assert environment_mesh(12 * devices).size == devices
    assert environment_mesh(1).size == 1
    with pytest.raises(ValueError, match=f"num_devices is {devices + 1}, allowed: 0 to {devices}"):
        environment_mesh(12, devices + 1)
    with pytest.raises(ValueError, match="num_devices is 2, allowed: a divisor of 7"):
        environment_mesh(7, 2)


def test_a_function_of_one_argument_is_refused():
    def call():
        on_devices(environment_mesh(2, 1), lambda rows: rows)

    with pytest.raises(InputError, match=r"allowed function\(rows, same\)"):
        call()
    refused(call, "function(rows, same)")


@two_devices
@pytest.mark.slow
@pytest.mark.usefixtures("quick_compiles")  # which last to the end of the file
def test_devices_change_nothing_on_the_highway():
    """To rounding, since compiled quickly; tests/test_determinism.py has it bit for bit, fully optimised."""
    env, params = medjax.make("paper", episode_decisions=3)
    alone = course(env, params, 4, None, 8)
    shared = course(env, params, 4, 2, 8)
    _, _, _, truncated, _ = alone[1]
    assert truncated.any()  # so resets are among it
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), alone[1], shared[1]
    )


@pytest.mark.parametrize(
    ("kilobytes", "group", "copies", "fit"),
    [
        (1, 1, 1, 128),
        (33, 1, 1, 64),
        (112, 1, 1, 16),
        (112, 16, 1, 16),
        (10**6, 1, 1, 1),
        (16, 9, 4, 18),
    ],
)
def test_large_rows_share_a_cache_with_fewer(kilobytes, group, copies, fit):
    row = {"a": jax.ShapeDtypeStruct((4, kilobytes, 16, 8), jnp.float64)}
    assert rows_that_fit(row, group, copies) == fit


@pytest.mark.parametrize(("group", "seen"), [(1, 64), (32, 64), (128, 128)])
def test_a_block_holds_the_rows_that_fit(group, seen):
    """Rows of 40 kB: 76 fit 3 MiB, of which 64 are a power of two."""
    blocks = []

    def count(rows):
        blocks.append(rows.shape[0])
        return rows[:, 0]

    in_blocks(count, jnp.zeros((256, 10_000)), group=group)
    assert blocks == [seen]
