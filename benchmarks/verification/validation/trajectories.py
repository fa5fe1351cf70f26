"""Positions of vehicles at each tick, from any simulator: the input of all measurements."""

from __future__ import annotations

import dataclasses

import numpy as np

from medjax.world.params import EnvConfig, EnvParams

NOBODY = -1
STANDING = 0.5  # m/s; a slower vehicle counts as standing


@dataclasses.dataclass(frozen=True)
class Road:
    """The road; lanes are 0 (leftmost) to num_lanes - 1, and num_lanes is an acceleration lane."""

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
class Bodies:
    """Size of each kind of vehicle, `(num_kinds,)` m."""

    length: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, params: EnvParams) -> Bodies:
        """The vehicles of a world."""
        drivers = params.drivers
        return cls(*(np.asarray(m, float) for m in (drivers.vehicle_length, drivers.vehicle_width)))


@dataclasses.dataclass(frozen=True)
class Trajectories:
    """R rows, one per vehicle and tick, sorted by vehicle and then by tick.

    A vehicle's ticks have no gaps. Positions x are of the front bumper.
    """

    road: Road
    tick_s: float
    num_ticks: int  # observed, including ticks without vehicles
    tick: np.ndarray  # (R,) int32, from 0
    vehicle: np.ndarray  # (R,) int32, one number per vehicle
    lane: np.ndarray  # (R,) int32
    x: np.ndarray  # (R,) float64, m
    speed: np.ndarray  # (R,) float64, m/s
    length: np.ndarray  # (R,) float64, m, of the vehicle
    width: np.ndarray  # (R,) float64, m
    # (R,) float64, m to the right of the leftmost lane's centre; None if unknown
    lateral: np.ndarray | None

    @property
    def span_s(self) -> float:
        """Observed time, s."""
        return self.num_ticks * self.tick_s

    @property
    def goes_on(self) -> np.ndarray:
        """Whether rows i and i + 1 are of the same vehicle, (R - 1,) bool."""
        return self.vehicle[1:] == self.vehicle[:-1]

    @property
    def on_ramp(self) -> np.ndarray:
        """Whether each row is on an acceleration lane, (R,) bool."""
        return self.lane == self.road.num_lanes

    def acceleration(self) -> np.ndarray:
        """Mean over the tick that led to each row, (R,) m/s2; NaN in a vehicle's first row."""
        change = np.diff(self.speed, prepend=np.nan) / self.tick_s
        return np.where(np.r_[False, self.goes_on][: len(change)], change, np.nan)


@dataclasses.dataclass(frozen=True)
class Neighbours:
    """Rows of the vehicles ahead of and behind each row, in its lane and tick."""

    ahead: np.ndarray  # (R,) int64, row, or NOBODY
    behind: np.ndarray  # (R,) int64, row, or NOBODY
    gap: np.ndarray  # (R,) m from the front bumper to the leader's rear, inf without a leader


def neighbours(seen: Trajectories) -> Neighbours:
    """Finds the neighbours of all rows with one sort."""
    order = np.lexsort((seen.x, seen.tick * (seen.road.num_lanes + 1) + seen.lane))
    here, next_up = order[:-1], order[1:]
    together = (seen.tick[here] == seen.tick[next_up]) & (seen.lane[here] == seen.lane[next_up])
    here, next_up = here[together], next_up[together]
    ahead, behind = np.full((2, len(seen.x)), NOBODY)
    ahead[here], behind[next_up] = next_up, here
    gap = np.full(len(seen.x), np.inf)
    gap[here] = seen.x[next_up] - seen.length[next_up] - seen.x[here]
    return Neighbours(ahead, behind, gap)
