"""The demands that traffic is measured under, from free to overloaded, and the worlds that bring them."""

from __future__ import annotations

import dataclasses

NOMINAL = 2000.0  # vehicles/h/lane that a load of 1 brings to the last detector
JAM_M = 8.0  # a standing vehicle's room, for the number of slots


@dataclasses.dataclass(frozen=True)
class Demand:
    """Traffic that asks to enter, vehicles/h; a rising one goes from `from_share` of that to all of it."""

    name: str
    mainline: float  # all lanes
    ramp: float  # each ramp
    from_share: float = 1.0  # of both in the first minute
    rising_minutes: int = 0  # until all of it, measured ones

    def share_at(self, minute: int, warm_up: int) -> float:
        """Of the demand in a minute, the warm-up's counted."""
        if not self.rising_minutes:
            return 1.0
        done = min(max(minute - warm_up, 0) / self.rising_minutes, 1.0)
        return self.from_share + (1.0 - self.from_share) * done
