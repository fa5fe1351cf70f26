"""Flat reads and writes against NumPy's indexing, under every nesting of vmap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.numerics.gathers import read, write

pytestmark = pytest.mark.versions

rng = np.random.default_rng(0)
VALUES = rng.normal(size=(2, 3, 7)).astype(np.float32)
NAMES = rng.integers(0, 99, (2, 3, 7))
INDEX = rng.integers(0, 7, (2, 3, 4, 5))


def test_read_of_rows():
    """A tree of rows, batched twice, with an index of several axes."""
    got, names = jax.vmap(jax.vmap(read))((VALUES, NAMES), INDEX)
    expected = [[VALUES[i, j][INDEX[i, j]] for j in range(3)] for i in range(2)]
    np.testing.assert_array_equal(got, expected)
    expected = [[NAMES[i, j][INDEX[i, j]] for j in range(3)] for i in range(2)]
    np.testing.assert_array_equal(names, expected)


def test_read_with_one_table_or_one_index():
    table, index = VALUES[0, 0], INDEX[0]
    np.testing.assert_array_equal(jax.vmap(read, (None, 0))(table, index), table[index])
    got = jax.vmap(read, (0, None))(VALUES[0], index[0])
    np.testing.assert_array_equal(got, VALUES[0][:, index[0]])


@pytest.mark.parametrize("order", ["grad of vmap", "vmap of grad"])
def test_read_is_differentiable(order):
    """The gradient of a sum of squares counts each entry as often as it was read."""

    def energy(values, index):
        return jnp.sum(jnp.square(read((values, jnp.arange(7)), index)[0]))

    if order == "vmap of grad":
        got = jax.vmap(jax.grad(energy))(VALUES[0], INDEX[0])
    else:
        got = jax.grad(lambda values: jax.vmap(energy)(values, INDEX[0]).sum())(VALUES[0])
    times = np.stack([np.bincount(index.ravel(), minlength=7) for index in INDEX[0]])
    np.testing.assert_allclose(got, 2 * VALUES[0] * times, rtol=1e-6)
    slope = jax.jvp(lambda values: energy(values, INDEX[0, 0]), (VALUES[0, 0],), (VALUES[0, 0],))[1]
    np.testing.assert_allclose(slope, np.sum(got[0] * VALUES[0, 0]), rtol=1e-5)


def test_write_of_rows():
    """Batched twice; what is not written stays."""
    index = np.stack([[rng.permutation(7)[:4] for _ in range(3)] for _ in range(2)])
    fresh = rng.normal(size=(2, 3, 4)).astype(np.float32)
    got = jax.vmap(jax.vmap(write))(VALUES, index, fresh)
    expected = VALUES.copy()
    np.put_along_axis(expected, index, fresh, axis=-1)
    np.testing.assert_array_equal(got, expected)
    one = jax.vmap(write, (None, 0, None))(VALUES[0, 0], index[0], fresh[0, 0])
    for row, where in zip(one, index[0], strict=True):
        np.testing.assert_array_equal(np.asarray(row)[where], fresh[0, 0])
