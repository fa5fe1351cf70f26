"""The checker that `tests/conftest.py` gives to jaxtyping."""

import re

from beartype import beartype

# An annotation of jaxtyping, as a type or as text, or one of the names in `medjax.numerics.shapes`.
SHAPED = re.compile(r"jaxtyping\.|\[Array(Like)?, |\b(Numbers|Arrays|Floats)\b")


def shapes_only(function):
    """Checks annotations that have shapes; the others are for mypy, and bad input has messages of its own."""
    hints = function.__annotations__.items()
    function.__annotations__ = {name: hint for name, hint in hints if SHAPED.search(str(hint))}
    return beartype(function)
