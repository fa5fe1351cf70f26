"""Gives worlds any allowed numbers, including the ends of ranges, but leaves numbers that depend on other numbers."""

import math
from typing import Any

import numpy as np

from benchmarks.verification.draws import Draw, in_worlds
from medjax.world.numbers import Number
from medjax.world.params import GROUPS, OTHERS, EnvParams

# Only `random_worlds` draws these numbers. Other numbers bound them (places along the road, a state of charge that must
# be above another one), or they are whole numbers.
BOUND = {
    "road": ("length_m", "ramp_x_m", "acceleration_lane_m", "exit_x_m", "exit_lane_m"),
    "demand": ("arrival_soc_low", "arrival_soc_high", "surge_from_s", "surge_until_s"),
    "drivers": ("vehicle_length",),
    "fleet": ("size", "service_lane"),
    "incidents": (
        *("incident_from_s", "incident_until_s", "incident_from_x_m", "incident_until_x_m"),
        "incident_lane",
    ),
    "charging": ("request_soc", "target_soc", "depleted_blocks"),
}
# `with_anything` replaces the groups of driving behaviour together, and every other group independently.
DRIVING = ("drivers", "motion", "lane_change")
ORDERS = 4.0  # orders of magnitude to cover below the upper end of a range from 0
VAST = 1e9  # largest finite number drawn where infinity is allowed


def with_anything(draw: Draw, params: EnvParams) -> EnvParams:
    """In half of the worlds, replaces some groups of numbers by any allowed numbers.

    All orders of magnitude are equally likely. DRIVING counts as one group, and `battery_scale` as another.
    """
    strange, driving = draw(0.0, 1.0) < 0.5, draw(0.0, 1.0) < 0.5

    def anyhow(group: str) -> Any:
        """Worlds in which this group gets any allowed numbers, `(batch,)` bool."""
        own = draw(0.0, 1.0) < 0.5
        return strange & (driving if group in DRIVING else own)

    changed: dict[str, Any] = {}
    for group, numbers in GROUPS.items():
        which, member, drawn = anyhow(group), getattr(params, group), {}
        for name in sorted({*numbers} - {*BOUND.get(group, ())}):
            usual = np.asarray(getattr(member, name))
            any_value = any_of(draw, numbers[name], *usual.shape[which.ndim :])
            drawn[name] = in_worlds(which, any_value, usual)
        changed[group] = member.replace(**drawn)
    any_scale = any_of(draw, OTHERS["battery_scale"])
    changed["battery_scale"] = in_worlds(anyhow("battery_scale"), any_scale, params.battery_scale)
    # Vehicles from a ramp must be able to stop within the acceleration lane.
    most = 0.999 * np.sqrt(2.0 * changed["motion"].max_braking * params.road.acceleration_lane_m)
    changed["demand"] = changed["demand"].replace(
        ramp_speed=np.minimum(changed["demand"].ramp_speed, most)
    )
    return params.replace(**changed)


def any_of(draw: Draw, number: Number, *shape: int) -> Any:
    """Draws numbers of a range, `(batch, *shape)`; orders of magnitude are equally likely if the range has one sign."""
    low, high = number.low, min(number.high, VAST)
    if low < 0.0:
        return draw(low, high, *shape)
    orders = math.log10(high / low) if low > 0.0 else ORDERS
    below = draw(0.0, orders, *shape)
    values = np.clip(high * 10.0**-below, np.float32(low), np.float32(high))
    values = np.where(below == np.float32(orders), low, values)
    return np.where(below == 0.0, number.high, values).astype(np.float32)
