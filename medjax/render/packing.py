"""Arrays of an episode as one short text, for the player.

Numbers are rounded to whole multiples of a step. Along time they are replaced by differences (of differences), which
are small; these are written byte plane by byte plane, so that the many zero bytes lie together, and compressed.
`web/packing.js` undoes it.
"""

import base64
import gzip

import numpy as np

from medjax.errors import InputError

MISSING = -(2**31)  # what stands for a number that is not there (NaN)


class Packer:
    """Collects arrays; their order in the text is that of `add`."""

    def __init__(self) -> None:
        self.index: list[dict[str, object]] = []
        self._planes: list[bytes] = []

    def add(self, name: str, values: np.ndarray, step: float = 1.0, order: int = 1) -> None:
        """Adds an array.

        Args:
          name: of the array.
          values: `(rows, times)`; NaN where there is none.
          step: what numbers are rounded to.
          order: how often differences along time are taken.

        Raises:
          InputError: a number too large for its step.
        """
        steps = np.round(np.asarray(values, np.float64) / step)
        if np.nanmax(np.abs(steps), initial=0.0) >= 2**31:
            most = np.nanmax(np.abs(values))
            raise InputError(f"{name} holds {most:g}: allowed {2**31 * step:g}")
        whole = np.where(np.isnan(steps), MISSING, steps).astype(np.int64).astype(np.int32)
        for _ in range(order):
            whole = np.diff(whole, axis=1, prepend=np.int32(0))  # wraps around, as its sum does
        signed = whole.ravel()
        folded = ((signed << 1) ^ (signed >> 31)).astype("<u4")  # small numbers of either sign
        self._planes.append(folded.view(np.uint8).reshape(-1, 4).T.tobytes())
        rows, times = values.shape
        entry = {"name": name, "rows": rows, "times": times, "step": step, "order": order}
        self.index.append(entry)

    def text(self) -> str:
        """Everything, gzip in base64."""
        # No time stamp: the same recording gives the same file.
        return base64.b64encode(gzip.compress(b"".join(self._planes), 9, mtime=0)).decode("ascii")
