"""A number of the world is declared once, by `number`; what it may be, and the one check of all of them.

The ranges are wide: what they leave out is not meant, is no number in float32, or breaks what the simulator rests on.
Below, positions stay exact to 2 cm, and vehicles that follow each other are told apart by the sort of the road.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from medjax.errors import InputError, shown

Text = str | tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Number:
    """What is declared of a number; docs/parameters.md and the checks read it."""

    default: Any  # that of the preset `paper`
    low: float
    high: float  # both are allowed; inf allows infinity
    unit: str = ""
    text: Text = ""  # what it is, and where its default comes from
    whole: bool = False
    per: str = (
        ""  # "kind" of vehicle, "ramp", "exit" or "period": the field holds one number for each
    )

    def __str__(self) -> str:
        """What is allowed, in a message."""
        return f"{'a whole number' if self.whole else 'a number'} from {self.range}"

    @property
    def range(self) -> str:
        """`0 to 1e+06`, as the documentation has it."""
        return " to ".join(
            f"{bound:.10g}" if abs(bound) < 1e6 else f"{bound:g}" for bound in (self.low, self.high)
        )


def number(
    default: Any,
    low: float,
    high: float,
    unit: str = "",
    text: Text = "",
    **more: Any,
) -> Any:
    """A field of a dataclass that holds a number.

    Args:
      default: that of the preset `paper`. A tuple is one a kind of vehicle, a ramp or an exit, and becomes an array;
        with a tuple of texts, it is one a body (`BodyParams`), and the field has no default of its own.
      low, high: the allowed range, both ends included.
      unit: SI.
      text: what it is, and where its default comes from.
      **more: `whole` and `per` of `Number`.
    """
    declared = Number(default, low, high, unit, text, **more)
    metadata = {"number": declared}
    if isinstance(text, tuple):
        return dataclasses.field(metadata=metadata)
    if isinstance(default, tuple):
        return dataclasses.field(
            default_factory=lambda: np.array(default, np.float32), metadata=metadata
        )
    return dataclasses.field(default=default, metadata=metadata)


def numbers_of(kind: Any) -> dict[str, Number]:
    """What is declared of the numbers that a dataclass holds, by name."""
    return {
        field.name: field.metadata["number"]
        for field in dataclasses.fields(kind)
        if "number" in field.metadata
    }


def read_number(
    name: str,
    value: Any,
    limits: Number,
    shape: tuple[int, ...] = (),
    *,
    fill: bool = False,
    convert: bool = False,
) -> np.ndarray:
    """A field's value, checked; nothing is computed on a device.

    Args:
      name: of the field, for the message.
      value: a number, an array or a list of numbers.
      limits: what is declared of the field.
      shape: of the field.
      fill: whether a single number may stand for a whole array.
      convert: whether 3.0 may stand for a whole number.

    Returns:
      An array of the shape, float32, or int32 where the limits say so.

    Raises:
      InputError: one line that names the field, the value and what is allowed.
    """
    is_list = isinstance(value, list | tuple)
    given_shape = _shape_of_list(value) if is_list else getattr(value, "shape", ())
    if given_shape != shape and not (fill and given_shape == ()):
        raise InputError(f"{name} has shape {shown(given_shape)}: allowed {shape}")
    given = as_numbers(value)
    if given is None:
        raise InputError(f"{name} = {shown(value)}: allowed {limits}")
    with np.errstate(over="ignore"):  # what float32 cannot hold is refused below
        exact = given.astype(np.float64)
        single = exact.astype(np.float32)
    # A bound in float32 may lie just outside the bound, and is still allowed.
    low = min(limits.low, float(np.float32(limits.low)))
    high = max(limits.high, float(np.float32(limits.high)))
    good = (exact >= low) & (exact <= high)
    if limits.whole:
        good &= (exact == np.floor(exact)) & (convert or given.dtype.kind in "iu")
    if not good.all():
        wrong = given[~good].flat[0].item()
        raise InputError(f"{name} = {shown(wrong)}: allowed {limits}")
    return np.broadcast_to(exact.astype(np.int32) if limits.whole else single, shape)


def as_numbers(value: Any) -> np.ndarray | None:
    """Real numbers as an array of them, None for anything else; text and booleans are no numbers."""
    if isinstance(value, list | tuple):
        shape = _shape_of_list(value)
        items = value if len(shape) == 1 else [item for row in value for item in row]
        numbers = [_as_number(item) for item in items]
        return None if None in numbers else np.array(numbers, np.float64).reshape(shape)
    number = _as_number(value)
    if number is not None:
        return np.asarray(number)
    if not isinstance(value, np.ndarray | jax.Array) or not _is_real(value.dtype):
        return None
    try:
        array = np.asarray(value)
    except Exception:  # traced, deleted, or on another machine: nothing that can be looked at
        return None
    return array if array.dtype.kind in "iuf" else array.astype(np.float32)  # bfloat16


def _shape_of_list(value: Any) -> tuple[int, ...]:
    """Of a list, or of a list of rows that are equally long."""
    widths = {len(row) if isinstance(row, list | tuple) else None for row in value}
    width = widths.pop() if len(widths) == 1 else None
    return (len(value),) if width is None else (len(value), width)


def _as_number(value: Any) -> int | float | None:
    """One real number as Python's, None for anything else."""
    if isinstance(value, np.generic | np.ndarray | jax.Array) and value.ndim == 0:
        if not _is_real(value.dtype):
            return None
        try:
            value = value.item()
        except Exception:  # as in `as_numbers`
            return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    # Larger ones are in no range, and in no array.
    return value if isinstance(value, float) or abs(value) < 2**63 else None


def _is_real(dtype: Any) -> bool:
    return jax.dtypes.issubdtype(dtype, np.integer) or jax.dtypes.issubdtype(dtype, np.floating)
