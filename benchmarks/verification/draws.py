"""Random numbers between bounds, whose ends are met often."""

from collections.abc import Callable
from typing import Any

import numpy as np

Units = Callable[[tuple[int, ...]], np.ndarray]
"""Numbers in [0, 1] of the shape asked for, with axes of a batch before it."""


def reach_ends(units: Any, share: float = 0.1) -> Any:
    """Uniform numbers in [0, 1] to such of which that share is 0, and as many are 1."""
    return np.clip((units - share) / (1.0 - 2.0 * share), 0.0, 1.0)


def in_worlds(which: np.ndarray, one: Any, other: Any) -> Any:
    """The one in these worlds, the other elsewhere, `(batch, ...)`, of the other's type."""
    other = np.asarray(other)
    own = which.reshape(which.shape + (1,) * (other.ndim - which.ndim))
    return np.where(own, one, other).astype(other.dtype)


def random_units(rng: np.random.Generator, batch: int) -> Units:
    """Of `batch` worlds side by side."""
    return lambda shape: reach_ends(rng.random((batch, *shape)))


class Draw:
    """Uniform draws between bounds, as float32 within them."""

    def __init__(self, units: Units) -> None:
        self.units = units

    def __call__(self, low: Any, high: Any, *shape: int) -> Any:
        """Between the two, `(batch, *shape)`."""
        low, high = (np.asarray(bound, np.float32) for bound in (low, high))
        drawn = low + self.units(shape) * (high - low)
        return np.clip(drawn.astype(np.float32), low, high)

    def whole(self, low: int, high: int) -> Any:
        """A whole number from the one to the other, `(batch,)` int32."""
        return np.floor(low + self.units(()) * (high + 1 - low)).clip(low, high).astype(np.int32)
