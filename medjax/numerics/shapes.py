"""Types of arguments that broadcast; types with named axes stand where they are used."""

from typing import TYPE_CHECKING

from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float, Real

Numbers = Real[ArrayLike, "*#shape"]
"""A real number, or an array of them that broadcasts with the other arguments."""
if TYPE_CHECKING:
    Arrays = Array  # so that mypy knows its operators
else:
    Arrays = Float[ArrayLike, "*#shape"]
    """Floating numbers or arrays of them, as `Numbers`."""
Floats = Float[Array, "*shape"]
"""An array of the shape that the arguments broadcast to."""
