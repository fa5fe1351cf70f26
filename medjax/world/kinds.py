"""The kinds of vehicles. A new kind needs a row here, a column in `DriverParams`, and a share of the demand.

Every `(num_kinds,)` array, such as driver parameters and tallies, is in the order of `KINDS`. Files, messages
and metrics take the names of kinds from this table.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

# Classes of slots: a slot always belongs to the same class and holds one vehicle after another.
CLASSES = MEDS, EVS, FUELLED = ("MED", "EV", "gas")


class Kind(NamedTuple):
    """One kind of vehicle."""

    name: str  # display name
    slots: str  # class of the slots that hold it, one of CLASSES

    @property
    def column(self) -> str:
        """Name in files, such as `human_ev`."""
        return self.name.lower().replace(" ", "_")


KINDS = (
    Kind("MED", MEDS),
    Kind("human EV", EVS),
    Kind("autonomous EV", EVS),
    Kind("gas", FUELLED),
    Kind("lorry", FUELLED),
)
MED, HUMAN_EV, AUTONOMOUS_EV, GAS, LORRY = range(len(KINDS))


def kinds_in(*classes: str) -> tuple[int, ...]:
    """Kinds that the slots of these classes hold."""
    return tuple(index for index, kind in enumerate(KINDS) if kind.slots in classes)


GAS_KINDS = kinds_in(FUELLED)

# (num_kinds, 3), 1 where the slots of a class hold a kind.
_MEMBERS = np.array([[kind.slots == slots for slots in CLASSES] for kind in KINDS], np.float32)


def by_class(counts: Any) -> Any:
    """Sums counts by kind `(..., num_kinds)` to counts by class `(..., 3)`, in the order of CLASSES."""
    return (counts[..., :, None] * _MEMBERS).sum(-2)
