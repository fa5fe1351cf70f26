"""Arithmetic with the same bits in every program: alone, in a batch, on any number of devices.

XLA sums an axis in an order that depends on the surrounding shapes, so rewards would differ with the batch size.
"""

import jax
import jax.numpy as jnp


def sum_pairwise(values: jax.Array, axis: int = -1) -> jax.Array:
    """Sum over an axis, by adding one half to the other until one number is left.

    The result is the same in every program, and its error grows only with the logarithm of the length
    (Higham 1993, The accuracy of floating point summation).

    Args:
      values: `(..., n, ...)`, floats; pass products through `block_fma` first.

    Returns:
      `(..., ...)`.
    """
    axis %= values.ndim
    size = values.shape[axis]
    if size == 0:
        return jnp.sum(values, axis)
    while size > 1:
        half = -(-size // 2)
        first = jax.lax.slice_in_dim(values, 0, half, axis=axis)
        second = jax.lax.slice_in_dim(values, half, size, axis=axis)
        odd = [(0, 0)] * values.ndim
        odd[axis] = (0, 2 * half - size)
        values, size = first + jnp.pad(second, odd), half
    return jnp.squeeze(values, axis)


def block_fma(product: jax.Array) -> jax.Array:
    """Returns non-negative products `(...)` rounded, before they are summed.

    Some programs add a product without rounding it first (fused multiply-add). The comparison separates the two.
    """
    return jnp.maximum(product, 0.0)


def count_down(clock_s: jax.Array, dt: float) -> jax.Array:
    """A clock `(...)`, s, reduced by dt, s, but not below 0.

    A rest below a hundredth of dt is rounding error and becomes 0: 2 s less five times 0.4 s is 0.
    """
    left = clock_s - dt
    return jnp.where(left > 0.01 * dt, left, 0.0)


def scale_by(values: jax.Array, unit: jax.Array | float) -> jax.Array:
    """Values `(...)` / unit `()`, by multiplication with the unit's reciprocal.

    XLA does so in some programs only. The barrier keeps it from undoing the multiplication.
    """
    return values * jax.lax.optimization_barrier(jnp.float32(1.0) / unit)
