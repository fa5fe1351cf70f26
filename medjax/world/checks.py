"""Host-side checks of config and params: ranges, shapes, and numbers that must fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_type_hints

import jax
import numpy as np

from medjax.errors import InputError, shown
from medjax.physics import InductanceTable
from medjax.world.kinds import KINDS
from medjax.world.numbers import Number, as_numbers, read_number
from medjax.world.params import (
    GROUPS,
    OTHERS,
    EnvConfig,
    EnvParams,
    validate_config,
)
from medjax.world.weights import HOURS_OF_DAY, WEIGHT


def check_numbers(config: EnvConfig, params: EnvParams) -> EnvParams:
    """Checks everything except the coils' table; computes nothing on a device.

    Returns:
      The params, with every number as a NumPy array of its declared type and shape.

    Raises:
      InputError: names the field, its value and what is allowed.
    """
    validate_config(config)
    _check_type("params", params, EnvParams)
    shapes = _shapes(config)

    def read(name: str, value: Any, limits: Number) -> np.ndarray:
        return read_number(name, value, limits, shapes[limits.per])

    kinds = get_type_hints(EnvParams)
    changed: dict[str, Any] = {
        name: read(name, getattr(params, name), limits) for name, limits in OTHERS.items()
    }
    for group, ranges in GROUPS.items():
        member = getattr(params, group)
        _check_type(group, member, kinds[group])
        changed[group] = member.replace(
            **{
                name: read(f"{group}.{name}", getattr(member, name), limits)
                for name, limits in ranges.items()
            }
        )
    _check_type("reward_weights", params.reward_weights, Mapping)
    changed["reward_weights"] = {
        term: read(f"reward_weights.{term}", weight, WEIGHT)
        for term, weight in params.reward_weights.items()
    }
    checked = params.replace(**changed)
    _check_road(checked)
    _check_pairs(config, checked)
    return checked


def check_made_for(config: EnvConfig, params: EnvParams) -> None:
    """Raises InputError if params do not fit config: checks shapes and, outside of `jit`, values."""
    shapes = _shapes(config)
    for group, ranges in GROUPS.items():
        for name, limits in ranges.items():
            got, expected = np.shape(getattr(getattr(params, group), name)), shapes[limits.per]
            if got != expected:
                raise InputError(
                    f"params were made for another config: {group}.{name} has shape {got}, allowed {expected}"
                )
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(params)):
        _check_pairs(config, params)


def _shapes(config: EnvConfig) -> dict[str, tuple[int, ...]]:
    """Shape of a number for each value of `Number.per`."""
    return {
        "": (),
        "kind": (len(KINDS),),
        "ramp": (config.num_ramps,),
        "exit": (config.num_exits,),
        "period": (config.num_periods, 1 + config.num_ramps),
        "incident": (config.num_incidents,),
        "hour": (HOURS_OF_DAY,),
    }


def _check_type(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise InputError(f"{name} = {shown(value)}: allowed {kind.__name__}")


def _check_road(params: EnvParams) -> None:
    road = params.road
    lane_m = float(road.acceleration_lane_m)
    stop_m = float(params.demand.ramp_speed) ** 2 / (2.0 * float(params.motion.max_braking))
    if road.ramp_x_m.size and lane_m < stop_m:
        raise InputError(
            f"acceleration_lane_m = {lane_m:g}: allowed at least {stop_m:g} m, to stop from ramp_speed"
        )
    last = float(road.length_m) - lane_m
    for x in road.ramp_x_m:
        if x > last:
            raise InputError(
                f"ramp_x_m = {x:g}: allowed 0 to {last:g} m (road less one merge lane)"
            )
    # A vehicle that enters at a ramp extends back by its length, where others may stand at the previous lane's end.
    comes = np.array([share > 0.0 for share in params.demand.class_shares])
    apart_m = lane_m + float(params.drivers.vehicle_length[comes].max())
    if (np.diff(road.ramp_x_m) <= apart_m).any():
        raise InputError(
            f"ramp_x_m = {shown(road.ramp_x_m.tolist())}: allowed ascending, more than acceleration_lane_m and the "
            f"longest vehicle_length = {apart_m:g} m apart"
        )
    exits, first = road.exit_x_m, float(road.exit_lane_m)
    if exits.size and (
        exits[0] < first or exits[-1] >= road.length_m or (np.diff(exits) <= 0).any()
    ):
        raise InputError(
            f"exit_x_m = {shown(exits.tolist())}: allowed ascending, from exit_lane_m = {first:g} m to below "
            f"length_m = {float(road.length_m):g} m"
        )


def _check_pairs(config: EnvConfig, params: EnvParams) -> None:
    """Checks numbers that another number bounds."""
    demand, charging, fleet = params.demand, params.charging, params.fleet
    road, incidents = params.road, params.incidents
    earliest, latest = incidents.incident_from_s, incidents.incident_until_s
    nearest, farthest = incidents.incident_from_x_m, incidents.incident_until_x_m
    end_s = float(params.episode_decisions) * config.decision_s
    surge_s = demand.surge_from_s if config.num_surges else 0.0
    pairs: tuple[tuple[str, Any, str, Any], ...] = (
        ("arrival_soc_low", demand.arrival_soc_low, "arrival_soc_high", demand.arrival_soc_high),
        ("surge_from_s", demand.surge_from_s, "surge_until_s", demand.surge_until_s),
        ("surge_from_s", surge_s, "the episode's end", end_s),
        ("request_soc", charging.request_soc, "target_soc", charging.target_soc),
        ("service_lane", fleet.service_lane, "num_lanes - 1", config.num_lanes - 1),
        ("fleet size", fleet.size, "num_meds", config.num_meds),
        ("incident_from_s", earliest, "incident_until_s", latest),
        ("incident_from_s", earliest, "the episode's end", end_s),
        ("incident_from_x_m", nearest, "incident_until_x_m", farthest),
        ("incident_until_x_m", farthest, "length_m", road.length_m),
        ("incident_lane", incidents.incident_lane, "num_lanes - 1", config.num_lanes - 1),
    )
    for name, given, bound, most in pairs:
        values, mosts = np.broadcast_arrays(given, most)
        for value, limit in zip(values.flat, mosts.flat, strict=True):
            if value > limit:
                raise InputError(f"{name} = {value:g}: allowed at most {bound} = {limit:g}")


def validate(config: EnvConfig, params: EnvParams) -> None:
    """Checks config and unbatched params on the host, the coils' table included.

    Raises:
      InputError: names the field, its value and what is allowed.
    """
    check_numbers(config, params)
    table = params.link.inductance
    _check_type("link.inductance", table, InductanceTable)
    for name, value in vars(table).items():
        array = as_numbers(value)
        if array is None or array.ndim != 3 * (name == "values") or not np.isfinite(array).all():
            raise InputError(
                f"link.inductance.{name} = {shown(value)}: allowed a table from build_link"
            )
