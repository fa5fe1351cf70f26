"""The error of pairwise sums."""

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.numerics.sums import sum_pairwise

pytestmark = pytest.mark.usefixtures("quick_compiles")

ROUNDING = 2.0**-24  # of float32, relative


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("shape", [(5, 1, 8), (40, 3, 7), (2, 9, 33)])
def test_pairwise_sums_along_any_axis(shape, axis):
    """Within the bound of Higham 1993, eq. (3.6), of float64's sum."""
    values = np.random.default_rng(axis).uniform(-1.0, 1.0, shape).astype(np.float32)
    found = np.asarray(sum_pairwise(jnp.asarray(values), axis=axis))
    exact = values.astype(np.float64).sum(axis)
    rounds = np.ceil(np.log2(shape[axis]))
    bound = 1.001 * rounds * ROUNDING * np.abs(values).sum(axis, dtype=np.float64)
    assert found.shape == exact.shape
    assert (np.abs(found - exact) <= bound).all()
