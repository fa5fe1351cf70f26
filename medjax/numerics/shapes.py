"""Types of arguments that broadcast; types with named axes stand where they are used."""

from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float, Real

Numbers = Real[ArrayLike, "*#shape"]
"""A real number, or an array of them that broadcasts with the other arguments."""
Arrays = Float[Array, "*#shape"]
"""A JAX array that broadcasts with the other arguments."""
Floats = Float[Array, "*shape"]
"""An array of the shape that the arguments broadcast to."""
