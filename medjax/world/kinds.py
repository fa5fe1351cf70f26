"""The kinds of vehicles. A row here, a column in the drivers' numbers, and who drives one: that is a kind.

Every `(num_kinds,)` array is in the order of `KINDS`: drivers' numbers, tallies. What files, messages and
metrics say of kinds follows from the table.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

# Classes of slots: a slot belongs to one for good, and to one vehicle of it after the other.
CLASSES = MEDS, EVS, FUELLED = ("MED", "EV", "gas")


class Kind(NamedTuple):
    """One kind of vehicles."""

    name: str  # for people
    slots: str  # class of the slots that hold it, one of CLASSES
    width_m: float  # of its body

    @property
    def column(self) -> str:
        """Name in files, `human_ev`."""
        return self.name.lower().replace(" ", "_")


KINDS = (
    Kind("MED", MEDS, 2.5),
    Kind("human EV", EVS, 1.8),
    Kind("autonomous EV", EVS, 1.8),
    Kind("gas", FUELLED, 1.8),
    Kind("lorry", FUELLED, 2.55),
)
MED, HUMAN_EV, AUTONOMOUS_EV, GAS, LORRY = range(len(KINDS))


def kinds_in(*classes: str) -> tuple[int, ...]:
    """Kinds that the slots of these classes hold."""
    return tuple(index for index, kind in enumerate(KINDS) if kind.slots in classes)


GAS_KINDS = kinds_in(FUELLED)
WIDTHS_M = tuple(kind.width_m for kind in KINDS)

# Whether the slots of a class, a column in the order of CLASSES, hold a kind, a row.
_MEMBERS = np.array([[kind.slots == slots for slots in CLASSES] for kind in KINDS], np.float32)


def by_class(counts: Any) -> Any:
    """Counts of each kind `(..., num_kinds)` added up by class, `(..., 3)` in the order of CLASSES."""
    return (counts[..., :, None] * _MEMBERS).sum(-2)
