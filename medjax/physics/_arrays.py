"""The one rule about number types that the formulas of this package share."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


def as_floats(*values: ArrayLike) -> tuple[jax.Array, ...]:
    """Gives all values, numbers or arrays, one strong floating type, each keeping its own shape.

    The type is the widest among the arrays given: float64 stays float64 where x64 is on. Python numbers and integer
    arrays count as JAX's default float. The result is never weakly typed, so that a formula fed with literals and one
    fed with arrays compile to the same program.
    """
    dtype = jnp.result_type(0.0, *values)
    return tuple(jnp.asarray(value, dtype) for value in values)
