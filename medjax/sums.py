"""Sums of floats that come out the same, bit for bit, in every program.

XLA adds up an axis in an order that depends on the shapes around it: one environment alone, and the same
one among a hundred, would differ in the last digits of their reward.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp


def sum_pairwise(values: jax.Array) -> jax.Array:
    """Sum over the last axis, one half added to the other until one number is left.

    Besides being the same in every program, its error grows with the logarithm of the length only
    (Higham 1993, The accuracy of floating point summation).

    Args:
      values: `(..., n)`, floats.

    Returns:
      `(...)`.
    """
    size = values.shape[-1]
    if size == 0:
        return jnp.zeros(values.shape[:-1], values.dtype)
    while size > 1:
        half = -(-size // 2)
        values = values[..., :half] + _padded(values[..., half:], half)
        size = half
    return values[..., 0]


def _padded(values: jax.Array, size: int) -> jax.Array:
    lead = [(0, 0)] * (values.ndim - 1)
    return jnp.pad(values, [*lead, (0, size - values.shape[-1])])
