"""The demands that traffic is measured under, from free to overloaded, and the worlds that bring them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

import medjax
from medjax.env.charging_env import ChargingEnv
from medjax.traffic.idm import IDM, IDM_PLUS
from medjax.world.kinds import GAS
from medjax.world.params import EnvConfig, EnvParams

WARM_UP_MINUTES = 5  # until the road has filled, and what an empty one does is over

# Of one program for all demands: compiling costs more than playing. A road of queues holds some 80 a km and lane.
SLOTS = 1400


@dataclasses.dataclass(frozen=True)
class Demand:
    """Traffic that asks to enter, vehicles/h; a rising one is `from_share` of that at first."""

    name: str
    mainline_per_h: float  # all lanes
    ramp_per_h: float  # each ramp
    from_share: float = 1.0

    def share_at(self, minute: int, minutes: int) -> float:
        """Of the demand, in a minute of so many; a rising one is whole half way, so that its queue is seen, too."""
        risen = min(max(2.0 * minute / minutes, 0.0), 1.0)
        return self.from_share + (1.0 - self.from_share) * risen


# Loads of 0.45, 0.71, 0.9, 1 and 1.2 on four lanes of 2,000 vehicles/h.
CONSTANT = (
    Demand("paper", 2600.0, 250.0),
    Demand("merging", 4500.0, 300.0),
    Demand("dense", 6000.0, 300.0),
    Demand("capacity", 6800.0, 300.0),
    Demand("overload", 7600.0, 500.0),
)
# From 0.6 to 1.2, for capacity and its drop: the road is seen before, at and after the breakdown.
RISING = Demand("rising", 7600.0, 500.0, from_share=0.5)
DEMANDS = {demand.name: demand for demand in (*CONSTANT, RISING)}


@dataclasses.dataclass(frozen=True)
class Schedule:
    """What both simulators are given for an episode: sizes, and the numbers of each minute."""

    config: EnvConfig
    params_at: Callable[[int], EnvParams]  # of a minute, the warm-up's counted
    minutes: int  # that are measured
    warm_up_minutes: int = WARM_UP_MINUTES

    @property
    def all_minutes(self) -> int:
        """With the warm-up."""
        return self.warm_up_minutes + self.minutes


@functools.cache
def _highway(following: IDM) -> tuple[ChargingEnv, EnvParams]:
    """The road of `paper` with traffic alone: no EVs, so that nobody runs out, and no MEDs sent."""
    return medjax.make(
        "paper", following=following, num_gas=SLOTS, num_evs=1, num_meds=1, ev_share=0.0
    )


def world(demand: Demand, minutes: int, following: IDM = IDM_PLUS) -> tuple[ChargingEnv, Schedule]:
    """The road of `paper` under a demand, driven by a car-following model.

    Args:
      demand: what asks to enter; of one that rises twice as much is measured.
      minutes: that are measured.
    """
    env, params = _highway(following)
    ramps = np.full(env.config.num_ramps, demand.ramp_per_h, np.float32)
    minutes = minutes if demand.from_share == 1.0 else 2 * minutes

    def params_at(minute: int) -> EnvParams:
        share = np.float32(demand.share_at(minute - WARM_UP_MINUTES, minutes))
        asks = {"mainline_per_h": share * np.float32(demand.mainline_per_h)}
        return params.replace(demand=params.demand.replace(ramp_per_h=share * ramps, **asks))

    return env, Schedule(env.config, params_at, minutes)


def free_speed(schedule: Schedule) -> float:
    """Of free traffic, m/s: what drivers want."""
    return float(schedule.params_at(0).drivers.desired_speed[GAS])


def asked(schedule: Schedule) -> dict[str, float]:
    """What asks to enter in the measured minutes, vehicles/h: at x = 0, and at all ramps."""
    minutes = range(schedule.warm_up_minutes, schedule.all_minutes)
    demands = [schedule.params_at(minute).demand for minute in minutes]
    return {
        "asked_main_per_h": float(np.mean([demand.mainline_per_h for demand in demands])),
        "asked_ramps_per_h": float(np.mean([np.sum(demand.ramp_per_h) for demand in demands])),
    }
