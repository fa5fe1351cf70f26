"""Complete elliptic integrals, against SciPy and closed forms."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from medjax.physics import ellipe, ellipk

pytestmark = pytest.mark.versions

TOLERANCE = {np.float32: 1e-6, np.float64: 1e-12}
# Zero, both sides of it, the middle, and ever nearer 1; each is the same number in both types.
NEAR_ONE = 1 - 2.0 ** -np.arange(2, 24)
PARAMETERS = np.concatenate(
    [[0.0], np.float32(np.logspace(-8, -1, 15)), np.linspace(0, 0.984375, 64), NEAR_ONE]
).astype(np.float64)
NEGATIVE = -np.concatenate([np.float32(np.logspace(-8, 6, 57))]).astype(np.float64)
PAIRS = [(ellipk, special.ellipk), (ellipe, special.ellipe)]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("ours", "reference"), PAIRS)
@pytest.mark.parametrize("m", [PARAMETERS, NEGATIVE], ids=["positive", "negative"])
def test_values_are_scipys(ours, reference, m, dtype):
    with jax.enable_x64(True):
        value = np.asarray(jax.jit(ours)(m.astype(dtype)))
    assert value.dtype == dtype
    np.testing.assert_allclose(value, reference(m), rtol=TOLERANCE[dtype])


@pytest.mark.parametrize(("ours", "reference"), PAIRS)
def test_float64_values_hold_to_the_last_step_before_one(ours, reference):
    distance = 2.0 ** -np.arange(24, 53)
    m = 1 - distance
    expected = special.ellipkm1(distance) if ours is ellipk else reference(m)
    with jax.enable_x64(True):
        np.testing.assert_allclose(ours(m), expected, rtol=1e-12)


def test_ends_of_the_range():
    assert float(ellipk(0.0)) == pytest.approx(np.pi / 2, rel=1e-7)
    assert float(ellipe(0.0)) == pytest.approx(np.pi / 2, rel=1e-7)
    assert float(ellipk(1.0)) == np.inf
    assert float(ellipe(1.0)) == 1.0
    assert np.isnan(float(ellipk(1.5)))
    assert np.isnan(float(ellipe(1.5)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("m", [PARAMETERS[PARAMETERS > 1e-3], NEGATIVE[NEGATIVE < -1e-3]])
def test_gradients_are_the_closed_forms(m, dtype):
    # DLMF 19.4.1 and 19.4.2, in float64; they cancel for small m, which the next test covers.
    k, e = special.ellipk(m), special.ellipe(m)
    slope_k = (e - (1 - m) * k) / (2 * m * (1 - m))
    slope_e = (e - k) / (2 * m)
    with jax.enable_x64(True):
        ours_k = np.asarray(jax.jit(jax.vmap(jax.grad(ellipk)))(m.astype(dtype)))
        ours_e = np.asarray(jax.jit(jax.vmap(jax.grad(ellipe)))(m.astype(dtype)))
    rtol = 2e-6 if dtype == np.float32 else 1e-11
    np.testing.assert_allclose(ours_k, slope_k, rtol=rtol)
    np.testing.assert_allclose(ours_e, slope_e, rtol=rtol)


@pytest.mark.parametrize("m", [0.0, 1e-8, -1e-8, 1e-4])
def test_gradients_at_small_m_are_the_power_series(m):
    # DLMF 19.5.1 and 19.5.2: K = pi/2 (1 + m/4 + 9 m^2/64 + 25 m^3/256 ...),
    # E = pi/2 (1 - m/4 - 3 m^2/64 - 5 m^3/256 ...).
    series_k = np.pi / 2 * (1 / 4 + 9 * m / 32 + 75 * m**2 / 256)
    series_e = -np.pi / 2 * (1 / 4 + 3 * m / 32 + 15 * m**2 / 256)
    with jax.enable_x64(True):
        assert float(jax.grad(ellipk)(m)) == pytest.approx(series_k, rel=1e-11)
        assert float(jax.grad(ellipe)(m)) == pytest.approx(series_e, rel=1e-11)


@settings(max_examples=100)
@given(st.floats(1e-6, 1 - 1e-6))
def test_legendres_relation(m):
    # DLMF 19.7.1: E(m) K(1-m) + E(1-m) K(m) - K(m) K(1-m) = pi/2.
    with jax.enable_x64(True):
        k, e = ellipk(np.array([m, 1 - m])), ellipe(np.array([m, 1 - m]))
        left = float(e[0] * k[1] + e[1] * k[0] - k[0] * k[1])
    assert left == pytest.approx(np.pi / 2, rel=1e-12)


def test_type_and_shape_follow_the_argument():
    with jax.enable_x64(True):
        assert ellipk(np.zeros((2, 3), np.float32)).dtype == np.float32
        assert ellipk(np.zeros((2, 3))).dtype == np.float64
        assert ellipe(np.zeros((2, 3))).shape == (2, 3)
    assert ellipe(0.5).dtype == np.float32
    assert not ellipk(0.5).weak_type
