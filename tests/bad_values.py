"""Values that no parameter accepts, made without the checks that must refuse them."""

import math

import jax.numpy as jnp
import numpy as np

NAN_ON_DEVICE, INF_ON_DEVICE = jnp.float32(math.nan), jnp.float32(math.inf)  # compiled here


class Unprintable:
    """Its `repr` raises."""

    def __repr__(self):
        raise RuntimeError("no")


def deep(levels):
    """Nested lists."""
    nested = []
    for _ in range(levels):
        nested = [nested]
    return nested


def heavy():
    """Few objects, but its text would exceed the memory."""
    level = ["x"] * 9
    for _ in range(12):
        level = [level] * 9
    return level


DEEP, HEAVY = deep(10_000), heavy()
NO_NUMBERS = (
    *(None, True, np.bool_(False), "", "3", "٣", "\ud800\n\0\u202e\x1b[2J", "9" * 10_000, b"3"),
    *({}, {"low": 1}, set(), object(), Unprintable(), 1j, np.complex64(1), np.array("3")),
    *(np.array([3], object), np.array(3, object), np.datetime64(3, "s"), lambda: 3, float, DEEP),
    *([deep(300)], HEAVY, [None, None, None, None], ["1", "2", "3", "4"], [True] * 4),
    *(np.zeros((4, 4)), np.zeros((0, 3)), np.zeros(4, bool), np.zeros(4, complex)),
    *(jnp.asarray(np.zeros((2, 2))), [0.0] * 100_000, range(4), iter([1.0])),
)
"""Values of the wrong type or shape."""


def outside(low, high, whole=False, infinite=False):
    """Numbers outside a range."""
    given = [math.nan, -math.inf, np.float32(math.nan), NAN_ON_DEVICE, -1e39, -1e308]
    given += [-(10**400), 10**400, 10**5000, -(2**63), low - 1, np.int64(low - 1), [math.nan] * 4]
    given += [low - (1e-6 * max(abs(low), 1)), np.float64(low - 1)]
    if low == 0:
        given += [-1e-6, np.float32(-1e-6), -5e-324]
    if low > 0:
        given += [0, 0.0, -0.0, 5e-324, low * 0.99]
    if not infinite:
        given += [math.inf, 1e308, 1e39, np.float64(1e39), INF_ON_DEVICE, 2**63, 2**31]
        given += [2**64, high + 1 if high < 2**50 else 10 * high, high * 1.001, [high * 2] * 4]
    if whole:
        given += [low + 0.5, np.float32(high - 0.5), 1e-3, [low + 0.5] * 4]
    return [value for value in given if not _allowed(value, low, high, whole)]


def _allowed(value, low, high, whole):
    """Whether the range allows a value after all."""
    if isinstance(value, list):
        return _allowed(value[0], low, high, whole)
    if isinstance(value, int):
        return low <= value <= high
    number = float(value)
    return low <= number <= high and (not whole or number == int(number))


def bad_values(row):
    """All invalid values of a documented number."""
    return [*NO_NUMBERS, *outside(row.low, row.high, row.whole, infinite=row.high == math.inf)]
