"""The floating type that the formulas of this package compute in."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


def as_floats(*values: ArrayLike) -> tuple[jax.Array, ...]:
    """Converts numbers and arrays `(...)` to the widest floating type among them; shapes stay.

    Python numbers and integer arrays count as JAX's default float. The result is never weakly typed, so a formula
    compiles to the same program for literals and for arrays.
    """
    dtype = jnp.result_type(0.0, *values)
    return tuple(jnp.asarray(value, dtype) for value in values)
