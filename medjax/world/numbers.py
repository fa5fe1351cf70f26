"""Declaration (`number`) and check (`read_number`) of every parameter.

The ranges are wide. They exclude only values that make no sense, that float32 cannot hold, or that break an assumption
of the simulator: within them, positions are exact to 2 cm, so sorting the road keeps consecutive vehicles apart.
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
    """Declaration of a number, from which the checks and docs/parameters.md are made."""

    default: Any  # of the preset `paper`
    low: float
    high: float  # both bounds are allowed; inf allows infinity
    unit: str = ""
    text: Text = ""  # description, and the source of the default
    whole: bool = False
    per: str = ""  # what each has a number: "kind", "ramp", "exit", "period", "incident", "hour"

    def __str__(self) -> str:
        """The allowed values, for messages."""
        return f"{'a whole number' if self.whole else 'a number'} from {self.range}"

    @property
    def range(self) -> str:
        """The range as the documentation writes it, such as `0 to 1e+06`."""
        return " to ".join(
            f"{bound:.10g}" if abs(bound) < 1e6 else f"{bound:g}" for bound in (self.low, self.high)
        )


def number(
    default: Any, low: float, high: float, unit: str = "", text: Text = "", **more: Any
) -> Any:
    """A dataclass field that holds a number.

    Args:
      default: of the preset `paper`. A tuple has one value per vehicle kind, ramp or exit, and becomes an array. If
        text is a tuple, too, there is one value per body (`BodyParams`), and the field itself has no default.
      low, high: the allowed range, both ends included.
      unit: SI.
      text: description, and the source of the default.
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
    """Declarations of the numbers in a dataclass, by name."""
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
    """Checks a field's value and converts it, without using a device.

    Args:
      name, limits, shape: of the field.
      value: a number, an array or a list of numbers.
      fill: whether a single number may fill a whole array.
      convert: whether 3.0 is accepted as a whole number.

    Returns:
      An array of the shape; int32 for whole numbers, else float32.

    Raises:
      InputError: names the field, the value and what is allowed.
    """
    is_list = isinstance(value, list | tuple)
    given_shape = _shape_of_list(value) if is_list else getattr(value, "shape", ())
    fills = fill and given_shape == ()
    if given_shape != shape and not fills:
        raise InputError(f"{name} has shape {shown(given_shape)}: allowed {shape}")
    if fills and 0 in shape:
        raise InputError(f"{name} = {shown(value)}: allowed with num_{limits.per}s of 1 or more")
    given = as_numbers(value)
    if given is None:
        raise InputError(f"{name} = {shown(value)}: allowed {limits}")
    with np.errstate(over="ignore"):  # values beyond float32 are rejected below
        exact = given.astype(np.float64)
        single = exact.astype(np.float32)
    # Rounding a bound to float32 may move it outside the range; it stays allowed.
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
    """Converts real numbers to an array; None for anything else, including text and booleans."""
    if isinstance(value, list | tuple):
        shape = _shape_of_list(value)
        items = value if len(shape) == 1 else [item for row in value for item in row]
        nested = any(isinstance(item, list | tuple) for item in items)
        numbers = [] if nested else [as_numbers(item) for item in items]
        plain = [number.item() for number in numbers if number is not None and not number.ndim]
        return np.array(plain, np.float64).reshape(shape) if len(plain) == len(items) else None
    if isinstance(value, int | float) and not isinstance(value, bool):
        # Larger integers exceed every range and overflow NumPy's integers.
        return np.asarray(value) if isinstance(value, float) or abs(value) < 2**63 else None
    if not isinstance(value, np.generic | np.ndarray | jax.Array):
        return None
    if not any(jax.dtypes.issubdtype(value.dtype, kind) for kind in (np.integer, np.floating)):
        return None
    try:
        array = np.asarray(value)
    except Exception:  # traced, deleted, or on another machine: the values cannot be read
        return None
    return array if array.dtype.kind in "iuf" else array.astype(np.float32)  # from bfloat16


def _shape_of_list(value: Any) -> tuple[int, ...]:
    """Shape of a list, or of a list of equally long rows."""
    widths = {len(row) if isinstance(row, list | tuple) else None for row in value}
    width = widths.pop() if len(widths) == 1 else None
    return (len(value),) if width is None else (len(value), width)
