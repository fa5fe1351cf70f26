"""Random numbers between bounds that often hit the bounds themselves."""

from collections.abc import Callable
from typing import Any

import numpy as np

Units = Callable[[tuple[int, ...]], np.ndarray]
"""Draws numbers in [0, 1] of a given shape, with leading batch axes."""


def reach_ends(units: Any, share: float = 0.1) -> Any:
    """Maps uniform numbers in [0, 1] so that this share of them is 0 and the same share is 1."""
    return np.clip((units - share) / (1.0 - 2.0 * share), 0.0, 1.0)


def in_worlds(which: np.ndarray, one: Any, other: Any) -> Any:
    """`one` in the worlds of `which` and `other` elsewhere, `(batch, ...)`, with the type of `other`."""
    other = np.asarray(other)
    own = which.reshape(which.shape + (1,) * (other.ndim - which.ndim))
    return np.where(own, one, other).astype(other.dtype)


def random_units(rng: np.random.Generator, batch: int) -> Units:
    """`Units` for `batch` worlds side by side."""
    return lambda shape: reach_ends(rng.random((batch, *shape)))


class Draw:
    """Draws uniform float32 numbers within bounds."""

    def __init__(self, units: Units) -> None:
        self.units = units

    def __call__(self, low: Any, high: Any, *shape: int) -> Any:
        """Numbers from `low` to `high`, `(batch, *shape)`."""
        low, high = (np.asarray(bound, np.float32) for bound in (low, high))
        drawn = low + self.units(shape) * (high - low)
        return np.clip(drawn.astype(np.float32), low, high)

    def whole(self, low: int, high: int) -> Any:
        """Whole numbers from `low` to `high`, `(batch,)` int32."""
        return np.floor(low + self.units(()) * (high + 1 - low)).clip(low, high).astype(np.int32)
