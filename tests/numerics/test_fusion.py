"""Values that XLA for CPUs computes once, however many read them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.numerics.fusion import settled

X = jnp.linspace(-1.0, 2.0, 4096)


def readers(settle):
    """A function whose polynomial has three readers, each of another shape."""

    def run(x):
        y = x
        for _ in range(8):
            y = y * x - 0.3
        y = settled(y, x > -2.0) if settle else y
        return y[::-1] + 1.0, y.reshape(64, 64).T - 2.0, y[::2] * 3.0

    return run


def products(settle, batch=False):
    """Multiplications in the compiled program."""
    run = jax.vmap(readers(settle)) if batch else readers(settle)
    text = jax.jit(run).lower(X[None] if batch else X).compile().as_text()
    return text.count(" multiply(")


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="only XLA for CPUs needs it")
@pytest.mark.parametrize("batch", [False, True])
def test_values_are_computed_once(batch):
    """8 products and the last reader's own, where each of the three readers has its 8 otherwise."""
    assert products(True, batch) == 9
    assert products(False, batch) == 25


def test_values_stay_as_they_are():
    for mine, theirs in zip(jax.jit(readers(True))(X), jax.jit(readers(False))(X), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-6)


def test_derivatives_pass_through():
    """Those of the polynomial, forwards and backwards, one by one and mapped."""

    def total(settle):
        return lambda x: sum(jnp.sum(part) for part in readers(settle)(x))

    mine, theirs = (jax.jit(jax.grad(total(settle)))(X) for settle in (True, False))
    np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-5)
    rows = jnp.stack([X, 0.5 * X])
    mapped = jax.vmap(jax.grad(total(True)))(rows)
    np.testing.assert_allclose(mapped[1], jax.grad(total(False))(rows[1]), rtol=1e-5, atol=1e-5)
