"""Complete elliptic integrals and their derivatives, by the arithmetic-geometric mean.

The two integrals and their derivatives all have the form

    I(m; p, q) = integral over [0, pi/2] of (p cos^2 x + q sin^2 x) / sqrt(1 - m sin^2 x) dx

with K = I(m; 1, 1), E = I(m; 1, 1 - m), dK/dm = I(m; 1, 0) / (2 (1 - m)), dE/dm = -I(m; 0, 1) / 2. Landen's
transformation leaves I unchanged while it brings the two means closer, and p and q with them (Bulirsch, Numer. Math. 7,
78-90, 1965; the mean itself: DLMF 19.8). Every step adds and multiplies positive numbers, so no digits cancel, as they
do in the textbook form E = K (1 - sum 2^(n-1) c_n^2) where m nears 1.
"""

import math

import jax
import jax.numpy as jnp

from medjax.numerics.shapes import Floats, Numbers
from medjax.physics._arrays import as_floats

# Every step squares the relative gap between the two means. From the smallest b that float64 can hold beside a = 1
# (1 - m = 1e-16, b = 1e-8), eight steps leave 1e-15, seven 5e-14.
_NUM_STEPS = 8


def ellipk(m: Numbers) -> Floats:
    """Complete elliptic integral of the first kind, K(m).

    Args:
      m: parameter m = k^2 (not the modulus k), at most 1, any shape `(...)`, dimensionless.

    Returns:
      K(m), shape `(...)`, in the floating type of `m`, with a finite gradient for m < 1. K(1) = inf, nan above 1.

    Source: DLMF 19.2.8 (definition), 19.8.5 (arithmetic-geometric mean).
    """
    return _ellipk(*as_floats(m))


def ellipe(m: Numbers) -> Floats:
    """Complete elliptic integral of the second kind, E(m).

    Args:
      m: parameter m = k^2 (not the modulus k), at most 1, any shape `(...)`, dimensionless.

    Returns:
      E(m), shape `(...)`, in the floating type of `m`, with a finite gradient for m < 1. E(1) = 1, nan above 1.

    Source: DLMF 19.2.8 (definition), 19.8.6 (arithmetic-geometric mean).
    """
    return _ellipe(*as_floats(m))


# Autodiff would go through the square root below, whose derivative grows without bound towards m = 1, whereas dE/dm
# hardly does: the terms would cancel to noise.
@jax.custom_jvp
def _ellipk(m: jax.Array) -> jax.Array:
    return _landen(m, jnp.ones_like(m), jnp.ones_like(m))


@jax.custom_jvp
def _ellipe(m: jax.Array) -> jax.Array:
    return _landen(m, jnp.ones_like(m), 1 - m)


_ellipk.defjvps(
    lambda dm, _, m: _landen(m, jnp.ones_like(m), jnp.zeros_like(m)) / (2 * (1 - m)) * dm
)
_ellipe.defjvps(lambda dm, _, m: -_landen(m, jnp.zeros_like(m), jnp.ones_like(m)) / 2 * dm)


def _landen(m: jax.Array, p: jax.Array, q: jax.Array) -> jax.Array:
    """I(m; p, q) of the module docstring, for p, q >= 0."""
    # At m = 1 the means never meet, so a fixed number of steps gives a wrong finite number.
    at_pole = jnp.where(q > 0, jnp.inf, p)
    a, b = jnp.ones_like(m), jnp.sqrt(1 - m)
    for _ in range(_NUM_STEPS):
        p, q = (p + q) / 2, (b * p + a * q) / (a + b)
        a, b = _means(a, b)
    return jnp.where(m == 1, at_pole, (math.pi / 4) * (p + q) / a)


def psi_sum(
    a_sq: jax.Array, b_sq: jax.Array, spread: jax.Array, num_steps: int
) -> tuple[jax.Array, jax.Array]:
    """The sum in Psi = (K / k) sum_{n>=1} 2^n c_n^2, and the mean that K divides by.

    Args:
      a_sq, b_sq: squares of the arithmetic and the geometric mean after a first step, `(...)`.
      spread: a_sq (a_sq - b_sq), computed without cancellation, `(...)`; c_1^2 is spread / a_sq.
      num_steps: steps of the mean after the first.

    Returns:
      (sum / spread, mean), `(...)` each; pi / (2 mean) is K up to the scale of a and b.

    Source: DLMF 19.8.
    """
    a, b = jnp.sqrt(a_sq), jnp.sqrt(b_sq)
    term = 1 / a_sq  # c_n^2 / spread
    total = 2 * term
    for step in range(num_steps):
        a, b = _means(a, b)
        term = spread * term**2 / (16 * a**2)
        total = total + 2 ** (step + 2) * term
    return total, a


def _means(a: jax.Array, b: jax.Array) -> tuple[jax.Array, jax.Array]:
    """One step of the arithmetic-geometric mean."""
    return (a + b) / 2, jnp.sqrt(a * b)
