"""The demands of the validation, from free flow to overload, and worlds with these demands."""

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

WARM_UP_MINUTES = 5  # until the road has filled and the transient is over

# Vehicle slots. All demands have as many, so that they share one compiled program: compiling takes longer than playing.
# Queues hold some 80 vehicles/km/lane.
SLOTS = 1400


@dataclasses.dataclass(frozen=True)
class Demand:
    """Demand in vehicles/h. A rising demand starts at `from_share` times these numbers."""

    mainline_per_h: float  # all lanes
    ramp_per_h: float  # each ramp
    from_share: float = 1.0

    def share_at(self, minute: int, minutes: int) -> float:
        """Share of the demand in a minute. A rising demand reaches 1 half-way, so that its queue shows as well."""
        risen = min(max(2.0 * minute / minutes, 0.0), 1.0)
        return self.from_share + (1.0 - self.from_share) * risen


# Degrees of saturation 0.45, 0.71, 0.9, 1 and 1.2 on four lanes of 2,000 vehicles/h.
DEMANDS = {
    "paper": Demand(2600.0, 250.0),
    "merging": Demand(4500.0, 300.0),
    "dense": Demand(6000.0, 300.0),
    "capacity": Demand(6800.0, 300.0),
    "overload": Demand(7600.0, 500.0),
    # From 0.6 to 1.2, to observe capacity and its drop before, at and after the breakdown.
    "rising": Demand(7600.0, 500.0, from_share=0.5),
}


@dataclasses.dataclass(frozen=True)
class Schedule:
    """An episode for both simulators: sizes, and the numbers of each minute."""

    config: EnvConfig
    params_at: Callable[[int], EnvParams]  # of a minute, counted from the start of the warm-up
    minutes: int  # measured, without the warm-up
    warm_up_minutes: int = WARM_UP_MINUTES

    @property
    def all_minutes(self) -> int:
        """Minutes including the warm-up."""
        return self.warm_up_minutes + self.minutes


@functools.cache
def _highway(following: IDM) -> tuple[ChargingEnv, EnvParams]:
    """The road of `paper` with gas vehicles only. Without EVs, nobody runs out of energy, and nobody sends MEDs."""
    return medjax.make(
        "paper", following=following, num_gas=SLOTS, num_evs=1, num_meds=1, ev_share=0.0
    )


def world(demand: Demand, minutes: int, following: IDM = IDM_PLUS) -> tuple[ChargingEnv, Schedule]:
    """The road of `paper` under a demand. A rising demand lasts twice as many minutes."""
    env, params = _highway(following)
    ramps = np.full(env.config.num_ramps, demand.ramp_per_h, np.float32)
    mainline_per_h = np.float32(demand.mainline_per_h)
    minutes = minutes if demand.from_share == 1.0 else 2 * minutes

    def params_at(minute: int) -> EnvParams:
        share = np.float32(demand.share_at(minute - WARM_UP_MINUTES, minutes))
        asks = {"mainline_per_h": share * mainline_per_h, "ramp_per_h": share * ramps}
        return params.replace(demand=params.demand.replace(**asks))

    return env, Schedule(env.config, params_at, minutes)


def free_speed(schedule: Schedule) -> float:
    """Speed of free traffic, m/s: the drivers' desired speed."""
    return float(schedule.params_at(0).drivers.desired_speed[GAS])


def mean_demand(schedule: Schedule) -> dict[str, float]:
    """Mean demand of the measured minutes, vehicles/h, at x = 0 and at all ramps."""
    measured = range(schedule.warm_up_minutes, schedule.all_minutes)
    demands = [schedule.params_at(minute).demand for minute in measured]
    return {
        "asked_main_per_h": float(np.mean([demand.mainline_per_h for demand in demands])),
        "asked_ramps_per_h": float(np.mean([np.sum(demand.ramp_per_h) for demand in demands])),
    }
