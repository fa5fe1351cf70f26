"""Packs the arrays of an episode into one short text for the player.

Numbers are rounded to whole multiples of a step. They are then differenced along time once or more, which makes them
small. The differences are written byte plane by byte plane, so that the many zero bytes lie together, and compressed.
`web/packing.js` reverses this.
"""

import base64
import gzip

import numpy as np

from medjax.errors import InputError

MISSING = -(2**31)  # stands for NaN


class Packer:
    """Collects arrays in the order of `add`."""

    def __init__(self) -> None:
        self.index: list[dict[str, object]] = []
        self._planes: list[bytes] = []

    def add(self, name: str, values: np.ndarray, step: float = 1.0, order: int = 1) -> None:
        """Adds an array.

        Args:
          name: of the array.
          values: `(rows, times)`, NaN where missing.
          step: numbers are rounded to its multiples.
          order: how often the values are differenced along time.

        Raises:
          InputError: a number is too large for the step.
        """
        steps = np.round(np.asarray(values, np.float64) / step)
        if np.nanmax(np.abs(steps), initial=0.0) >= 2**31:
            most = np.nanmax(np.abs(values))
            raise InputError(f"{name} holds {most:g}: allowed {2**31 * step:g}")
        whole = np.where(np.isnan(steps), MISSING, steps).astype(np.int64).astype(np.int32)
        for _ in range(order):
            whole = np.diff(whole, axis=1, prepend=np.int32(0))  # sums wrap around, too
        signed = whole.ravel()
        folded = ((signed << 1) ^ (signed >> 31)).astype("<u4")  # zigzag: small for either sign
        self._planes.append(folded.view(np.uint8).reshape(-1, 4).T.tobytes())
        rows, times = values.shape
        entry = {"name": name, "rows": rows, "times": times, "step": step, "order": order}
        self.index.append(entry)

    def text(self) -> str:
        """All arrays, gzipped and in base64."""
        # No time stamp, so that the same recording gives the same file.
        return base64.b64encode(gzip.compress(b"".join(self._planes), 9, mtime=0)).decode("ascii")
