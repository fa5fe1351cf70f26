"""What rounding must not decide: the bits of a sum, and when a clock has run down.

XLA adds up an axis in an order that depends on the shapes around it: one environment alone, and the same one among a
hundred, would differ in the last digits of their reward.
"""

import jax
import jax.numpy as jnp


def sum_pairwise(values: jax.Array, axis: int = -1) -> jax.Array:
    """Sum over an axis, one half added to the other until one number is left.

    Besides being the same in every program, its error grows with the logarithm of the length only
    (Higham 1993, The accuracy of floating point summation).

    Args:
      values: `(..., n, ...)`, floats; products as `rounded` gives them.

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


def rounded(product: jax.Array) -> jax.Array:
    """Products `(...)` that are not negative, as they are, for sums of them.

    A processor can add a product that it has not rounded yet (fused multiply-add). XLA lets it where the sum is next to
    the product, which is so in one program and not in another; here a comparison stands between them.
    """
    return jnp.maximum(product, 0.0)


def count_down(clock_s: jax.Array, dt: float) -> jax.Array:
    """A clock `(...)` s after another dt, s, not below 0.

    Less than a hundredth of dt is what rounding left over, and 0: five times 0.4 s taken off 2 s leave nothing.
    """
    left = clock_s - dt
    return jnp.where(left > 0.01 * dt, left, 0.0)


def in_units(values: jax.Array, unit: jax.Array | float) -> jax.Array:
    """Values `(...)` / unit `()`, by the unit's reciprocal.

    XLA does so itself where it sees that the divisor is one number, and divides where it does not, in a loop for one;
    the barrier keeps it from undoing this.
    """
    return values * jax.lax.optimization_barrier(jnp.float32(1.0) / unit)
