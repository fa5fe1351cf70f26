"""The road and the sizes of vehicles as plain numbers, for drawing."""

from __future__ import annotations

import dataclasses

import numpy as np

from medjax.charging.docking import CHARGING_SLOT_LANE, Partner, charging_slot_x
from medjax.world.kinds import HUMAN_EV, MED
from medjax.world.params import EnvConfig, EnvParams


@dataclasses.dataclass(frozen=True)
class Roadway:
    """Geometry of the road and of vehicles."""

    length_m: float
    num_lanes: int  # without acceleration lanes, whose index is num_lanes
    lane_width_m: float
    ramp_x_m: tuple[float, ...]  # where each acceleration lane starts
    acceleration_lane_m: float
    vehicle_length_m: tuple[float, ...]  # by kind
    vehicle_width_m: tuple[float, ...]  # by kind
    # By charging slot: an EV's front bumper there relative to the MED's, ahead and to the right.
    slots_m: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, config: EnvConfig, params: EnvParams) -> Roadway:
        """The road of one environment; `params` must not be batched."""
        road, lengths = params.road, np.asarray(params.drivers.vehicle_length)
        med = Partner(x=0.0, speed=0.0, lane=0, length=lengths[MED])  # type: ignore[arg-type]
        charging_slots, gap = np.arange(len(CHARGING_SLOT_LANE)), params.charging.dock_gap_m
        ahead = np.asarray(charging_slot_x(charging_slots, med, lengths[HUMAN_EV], gap))  # type: ignore[arg-type]
        aside = np.asarray(CHARGING_SLOT_LANE) * float(road.lane_width_m)
        return cls(
            length_m=float(road.length_m),
            num_lanes=config.num_lanes,
            lane_width_m=float(road.lane_width_m),
            ramp_x_m=tuple(map(float, np.asarray(road.ramp_x_m))),
            acceleration_lane_m=float(road.acceleration_lane_m),
            vehicle_length_m=tuple(map(float, lengths)),
            vehicle_width_m=tuple(map(float, np.asarray(params.drivers.vehicle_width))),
            slots_m=tuple(zip(map(float, ahead), map(float, aside), strict=True)),
        )

    @property
    def left_m(self) -> float:
        """Left edge of the asphalt, in m to the right of the leftmost lane's centre."""
        return -0.5 * self.lane_width_m

    @property
    def right_m(self) -> float:
        """Right edge of the through lanes."""
        return self.left_m + self.num_lanes * self.lane_width_m

    @property
    def shoulder_m(self) -> float:
        """Where EVs that ran out are marked, to the right of all traffic."""
        acceleration_lane = self.lane_width_m if self.ramp_x_m else 0.0
        return self.right_m + acceleration_lane + 0.4 * self.lane_width_m
