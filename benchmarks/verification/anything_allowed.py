"""Worlds of any numbers that are allowed, ends included, but for those that others bound."""

import math
from typing import Any

import numpy as np

from benchmarks.verification.draws import Draw
from medjax.world import params as groups
from medjax.world.numbers import Number
from medjax.world.params import EnvParams

# Drawn in `random_worlds` from all that the other numbers leave: places along the road, a charge that is to be above
# another one, whole numbers, and what may be infinite.
BOUND = {
    "road": ("length_m", "ramp_x_m", "acceleration_lane_m", "exit_x_m", "exit_lane_m"),
    "demand": ("arrival_soc_low", "arrival_soc_high"),
    "drivers": ("vehicle_length", "eco_horizon_m"),
    "fleet": ("size", "turnaround_s", "depot_power_w", "trip_m", "service_lane"),
    "charging": ("request_soc", "target_soc", "depleted_blocks"),
}
# What drivers do hangs together; any other group alone is enough to make a world a strange one.
DRIVING = ("drivers", "motion", "lane_change")
ORDERS = 4.0  # of magnitude below the end of a range that begins at 0


def with_anything(draw: Draw, params: EnvParams) -> EnvParams:
    """The worlds, in half of which some groups of numbers are any that are allowed.

    Orders of magnitude are equally likely. Drivers, motion and lane changes are of one group here.
    """
    strange, driving = draw(0.0, 1.0) < 0.5, draw(0.0, 1.0) < 0.5
    changed = {}
    for group, numbers in groups.GROUPS.items():
        own = draw(0.0, 1.0) < 0.5
        anyhow = strange & (driving if group in DRIVING else own)
        member, drawn = getattr(params, group), {}
        for name in sorted({*numbers} - {*BOUND.get(group, ())}):
            usual = np.asarray(getattr(member, name))
            any_value = _any(draw, numbers[name], usual.shape[anyhow.ndim :])
            which = anyhow.reshape(anyhow.shape + (1,) * (usual.ndim - anyhow.ndim))
            drawn[name] = np.where(which, any_value, usual).astype(usual.dtype)
        changed[group] = member.replace(**drawn)
    # Who comes down a ramp can stop at the end of its lane.
    most = 0.999 * np.sqrt(2.0 * changed["motion"].max_braking * params.road.acceleration_lane_m)
    changed["demand"] = changed["demand"].replace(
        ramp_speed=np.minimum(changed["demand"].ramp_speed, most)
    )
    return params.replace(**changed)


def _any(draw: Draw, number: Number, shape: tuple[int, ...]) -> Any:
    """Numbers of a range, orders of magnitude equally likely where it has one sign."""
    low, high = number.low, number.high
    if low < 0.0:
        return draw(low, high, *shape)
    if low > 0.0:
        values = np.exp(draw(math.log(low), math.log(high), *shape))
        return np.clip(values, np.float32(low), np.float32(high))
    orders = draw(0.0, ORDERS, *shape)
    return np.where(orders == ORDERS, 0.0, high * 10.0**-orders).astype(np.float32)
