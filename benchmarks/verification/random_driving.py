"""Worlds in which people drive in any way that is allowed."""

import math

import numpy as np

from benchmarks.verification.draws import Draw
from medjax.world import params as groups
from medjax.world.params import EnvParams

# How everyone drives; not how long vehicles are, for which the road must have room.
DRIVING = {
    "drivers": (
        "time_headway",
        "min_gap",
        "max_acceleration",
        "comfortable_deceleration",
        "acceleration_noise",
        "lateral_wander",
        "desired_speed",
        "desired_speed_std",
    ),
    "motion": tuple(groups.GROUPS["motion"]),
    "lane_change": tuple(groups.GROUPS["lane_change"]),
    "charging": (
        "approach_speed",
        "slowest_share",
        "approach_rate",
        "speed_rate",
        "platoon_headway",
        "platoon_min_gap",
        "dock_gap_m",
        "dock_tolerance_m",
        "dock_speed_tolerance",
        "hold_tolerance_m",
    ),
    "fleet": ("service_speed",),
}


def driven_anyhow(draw: Draw, params: EnvParams) -> EnvParams:
    """The worlds, in half of which people drive in any way that is allowed: orders of magnitude are equally likely."""
    anyhow = draw(0.0, 1.0) < 0.5
    changed = {}
    for group, names in DRIVING.items():
        member = getattr(params, group)
        drawn = {}
        for name in names:
            usual, limits = getattr(member, name), groups.GROUPS[group][name]
            size = usual.shape[anyhow.ndim :]
            if limits.low > 0.0:
                any_value = np.exp(draw(math.log(limits.low), math.log(limits.high), *size))
                any_value = np.clip(any_value, np.float32(limits.low), np.float32(limits.high))
            else:
                any_value = draw(limits.low, limits.high, *size)
            which = anyhow.reshape(anyhow.shape + (1,) * len(size))
            drawn[name] = np.where(which, any_value, usual)
        changed[group] = member.replace(**drawn)
    # Who comes down a ramp can stop at the end of its lane.
    most = 0.999 * np.sqrt(2.0 * changed["motion"].max_braking * params.road.acceleration_lane_m)
    demand = params.demand.replace(ramp_speed=np.minimum(params.demand.ramp_speed, most))
    return params.replace(demand=demand, **changed)
