"""Who was where at each tick, whoever simulated it: the one thing that is measured."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from medjax.world.params import EnvConfig, EnvParams

NOBODY = -1
STANDING = 0.5  # m/s; who is slower stands


@dataclasses.dataclass(frozen=True)
class Road:
    """The road that vehicles were seen on; lanes 0 (leftmost) to num_lanes - 1, num_lanes beside a ramp."""

    length_m: float
    num_lanes: int
    lane_width_m: float
    ramp_x_m: tuple[float, ...]  # ascending; where each acceleration lane starts
    acceleration_lane_m: float

    @classmethod
    def of(cls, config: EnvConfig, params: EnvParams) -> Road:
        """The road of a world."""
        road = params.road
        return cls(
            length_m=float(road.length_m),
            num_lanes=config.num_lanes,
            lane_width_m=float(road.lane_width_m),
            ramp_x_m=tuple(sorted(float(x) for x in np.asarray(road.ramp_x_m))),
            acceleration_lane_m=float(road.acceleration_lane_m),
        )


@dataclasses.dataclass(frozen=True)
class Trajectories:
    """Rows, one a vehicle and tick, sorted by vehicle and then by tick; R rows.

    A vehicle's ticks follow each other without a hole. The front bumper is what x is of.
    """

    road: Road
    tick_s: float
    num_ticks: int  # seen, whether anybody was there or not
    tick: np.ndarray  # (R,) int32, from 0
    vehicle: np.ndarray  # (R,) int32, one number a vehicle
    lane: np.ndarray  # (R,) int32
    x: np.ndarray  # (R,) float64, m
    speed: np.ndarray  # (R,) float64, m/s
    length: np.ndarray  # (R,) float64, m, of the vehicle
    width: np.ndarray  # (R,) float64, m
    lateral: (
        np.ndarray | None
    )  # (R,) float64, m right of the leftmost lane's centre; None: not known

    @property
    def span_s(self) -> float:
        """Time that was watched, s."""
        return self.num_ticks * self.tick_s

    @property
    def goes_on(self) -> np.ndarray:
        """Whether row i + 1 is of the same vehicle as row i, (R - 1,) bool."""
        goes_on: np.ndarray = self.vehicle[1:] == self.vehicle[:-1]
        return goes_on

    @property
    def on_ramp(self) -> np.ndarray:
        """On an acceleration lane, (R,) bool."""
        on_ramp: np.ndarray = self.lane == self.road.num_lanes
        return on_ramp

    def acceleration(self) -> np.ndarray:
        """Mean over the tick that led to each row, (R,) m/s2; NaN in a vehicle's first row."""
        acceleration = np.full(len(self.x), np.nan)
        change = np.diff(self.speed) / self.tick_s
        acceleration[1:] = np.where(self.goes_on, change, np.nan)
        return acceleration

    def after(self, seconds: float) -> Trajectories:
        """What was seen from then on, tick 0 then."""
        first = round(seconds / self.tick_s)
        keep = self.tick >= first
        names = ("vehicle", "lane", "x", "speed", "length", "width", "lateral")
        rows: dict[str, Any] = {
            name: None if (column := getattr(self, name)) is None else column[keep]
            for name in names
        }
        rows |= {"tick": self.tick[keep] - first, "num_ticks": self.num_ticks - first}
        return dataclasses.replace(self, **rows)


@dataclasses.dataclass(frozen=True)
class Neighbours:
    """Rows of the vehicles ahead of and behind each row in its lane, at its tick."""

    ahead: np.ndarray  # (R,) int64, row, or NOBODY
    behind: np.ndarray  # (R,) int64, row, or NOBODY
    gap: (
        np.ndarray
    )  # (R,) m from the front bumper to the rear of the one ahead, inf where there is nobody


def neighbours(seen: Trajectories) -> Neighbours:
    """Of every row, by one sort of all rows."""
    order = np.lexsort((seen.x, seen.tick * (seen.road.num_lanes + 1) + seen.lane))
    here, next_up = order[:-1], order[1:]
    together = (seen.tick[here] == seen.tick[next_up]) & (seen.lane[here] == seen.lane[next_up])
    here, next_up = here[together], next_up[together]
    ahead, behind = np.full((2, len(seen.x)), NOBODY)
    ahead[here], behind[next_up] = next_up, here
    gap = np.full(len(seen.x), np.inf)
    gap[here] = seen.x[next_up] - seen.length[next_up] - seen.x[here]
    return Neighbours(ahead, behind, gap)
