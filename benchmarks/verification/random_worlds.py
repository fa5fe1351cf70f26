"""Draws random valid worlds by seed, with sizes and numbers from the whole range that medjax supports.

Half of the worlds could be real roads: all numbers lie within the bounds below and often on them. In the other half,
some groups of numbers come from everything that `medjax.world.params` allows.
"""

import dataclasses
import json
import math
import operator
from typing import Any

import jax
import numpy as np

from benchmarks.verification.anything_allowed import any_of, with_anything
from benchmarks.verification.draws import Draw, Units, in_worlds, reach_ends
from medjax.env.reward import TERMS
from medjax.physics import InductanceTable
from medjax.world import params as groups
from medjax.world.checks import validate
from medjax.world.kinds import KINDS
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.weights import HOURS_OF_DAY, MarketParams

# Highest demand per hour and lane or ramp: no lane can take more.
SATURATED_PER_H = 3000.0
J_PER_KWH = 3.6e6
ROAD, LENGTH = groups.GROUPS["road"], groups.GROUPS["drivers"]["vehicle_length"]
KIND = (len(KINDS),)
# Usual range of each number, or a function that draws it, in the order of drawing.
USUAL: dict[str, dict[str, Any]] = {
    "demand": {
        "ramp_per_h": (0.0, SATURATED_PER_H), "ev_share": (0.0, 1.0), "human_share": (0.0, 1.0),
        "ramp_speed": (3.0, 25.0), "lorry_share": (0.0, 1.0), "exit_share": (0.0, 1.0),
        "surge_factor": (0.0, 5.0), "surge_s": (0.0, 60.0), "detector_s": (0.5, 300.0),
        "profile": (0.0, 1.0), "period_s": (5.0, 60.0), "start_s": (0.0, 60.0),
    },
    "drivers": {
        "desired_speed": (8.0, 45.0), "desired_speed_std": (0.0, 4.0), "time_headway": (0.6, 3.0),
        "min_gap": (1.0, 5.0), "max_acceleration": (0.5, 3.0), "comfortable_deceleration": (1.0, 4.0),
        "acceleration_noise": (0.0, 0.3), "lateral_wander": (0.0, 0.4),
        "vehicle_length": lambda draw: _sometimes(draw, any_of(draw, LENGTH, *KIND), draw(3.0, 20.0, *KIND)),
        "vehicle_width": (0.5, 2.6),
        "eco_compliance": (0.0, 1.0), "eco_speed": (5.0, 35.0), "eco_horizon_m": (0.0, 50e3),
        "eco_soc": (0.0, 1.0),
    },
    "motion": {
        "max_braking": (6.0, 10.0), "noise_time_s": (0.5, 20.0), "lateral_rate": (0.5, 4.0),
        "lateral_acceleration": (1.0, 4.0), "lateral_speed": (0.5, 2.0), "lateral_slope": (0.05, 0.3),
    },
    "lane_change": {
        "politeness": (0.0, 1.0), "threshold": (0.0, 1.0), "right_bias": (-1.0, 1.0),
        "safe_braking": (0.5, 5.0), "mandatory_bias": (0.0, 20.0), "urgency_bias": (0.0, 20.0),
        "accepted_headway": (0.3, 1.0), "relaxation_s": (1.0, 30.0), "courtesy_braking": (0.0, 3.0),
        "view_m": (50.0, 500.0), "exit_view_m": (20.0, 500.0), "recovery_s": (0.0, 20.0),
    },
    "charging": {
        "wanted_soc": (0.0, 1.0),
        "stop_soc": (0.0, 0.5), "reach_ahead_m": (0.0, 2000.0), "reach_behind_m": (0.0, 1000.0),
        "patience_s": (1.0, 120.0), "retry_s": (0.0, 30.0), "approach_speed": (1.0, 15.0),
        "approach_rate": (0.05, 1.0), "speed_rate": (0.2, 2.0), "platoon_headway": (0.25, 1.5),
        "platoon_min_gap": (1.0, 5.0), "dock_gap_m": (2.0, 20.0), "dock_tolerance_m": (0.1, 2.0),
        "dock_speed_tolerance": (0.1, 2.0), "hold_tolerance_m": (0.1, 4.0), "slot_power_w": (0.0, 200e3),
        "taper_soc": (0.0, 1.0), "slowest_share": (0.2, 1.0), "depleted_blocks": lambda draw: draw.whole(0, 1),
        "tow_s": (0.0, 120.0), "plug_power_w": (1e4, 1e6), "plug_target_soc": (0.0, 0.99),
        "queue_seen_share": (0.0, 1.0),
    },
    "link": {
        "panel_gap_m": (0.05, 0.6), "permeability": (0.5, 2.0), "max_current_a": (0.0, 300.0),
        "misalignment_scale": (0.0, 1.0), "load_ohm": (1.0, 50.0), "med_resistance_ohm": (0.01, 1.0),
        "ev_resistance_ohm": (0.01, 1.0), "angular_frequency": (1e5, 1e6),
    },
}  # fmt: skip
# Successive cases move through the unit cube by irrational steps (Roberts' R-sequence in 7 dimensions), so they spread
# evenly over it.
_PHI = 1.0923077
for _ in range(60):
    _PHI = (1.0 + _PHI) ** (1.0 / 8.0)
STEPS = _PHI ** -np.arange(1.0, 8.0)


def draw_config(seed: int, case: int) -> EnvConfig:
    """Sizes of case 0, 1, ... of a seed, spread evenly: 1-6 lanes, 0-8 ramps, 0-8 exits, 1-40 MEDs.

    A tick lasts 0.02-0.5 s.
    """
    start = np.random.default_rng(seed).random(len(STEPS))
    lanes, ramps, tick, ticks, meds, evs, gas = (start + case * STEPS) % 1.0
    num_lanes, num_ramps = 1 + int(6 * lanes), int(9 * ramps)
    num_exits = int(9 * ((lanes + ramps) % 1.0))
    return EnvConfig(
        num_lanes=num_lanes,
        num_ramps=num_ramps,
        num_depots=1 + int(num_ramps * max(2.0 * ((gas + lanes) % 1.0) - 1.0, 0.0)),
        num_exits=num_exits,
        num_plugs=int(4 * ((evs + meds) % 1.0)) if num_exits else 0,
        num_surges=int(3 * ((ramps + gas) % 1.0)) if num_ramps else 0,
        has_detectors=int(2 * ((meds + tick) % 1.0)),
        num_incidents=int(4 * ((tick + gas) % 1.0)) if int(40 * num_lanes * reach_ends(gas)) else 0,
        num_periods=1 + int(3 * ((evs + gas) % 1.0)),
        tick_s=round(float(0.02 + 0.48 * reach_ends(tick, 0.15)), 3),
        ticks_per_round=1 + int(8 * ticks),
        rounds_per_decision=1 + int(3 * ((ticks + meds) % 1.0)),
        num_meds=1 + int(40 * meds),
        num_evs=1 + int(60 * evs),
        num_gas=int(40 * num_lanes * reach_ends(gas)),
    )


def _road(draw: Draw, config: EnvConfig) -> groups.RoadParams:
    merge = _sometimes(draw, any_of(draw, ROAD["acceleration_lane_m"]), draw(100.0, 350.0))
    spaced = merge + LENGTH.high + 1.0
    shortest = np.maximum(ROAD["length_m"].low, (config.num_ramps + 0.1) * spaced)
    usual = draw(shortest, np.maximum(4000.0, shortest))
    length = _sometimes(draw, np.maximum(any_of(draw, ROAD["length_m"]), shortest), usual)
    spare = (0.999 * (length - spaced * config.num_ramps))[..., None]
    order = np.arange(config.num_ramps)
    lane = ROAD["exit_lane_m"]
    leave = draw(lane.low, np.minimum(0.5 * length, lane.high))
    # Each exit has its own part of the road, so that no two coincide.
    exits = (np.arange(config.num_exits) + draw(0.0, 0.9, config.num_exits)) / config.num_exits
    places = np.sort(draw(0.0, 1.0, config.num_ramps), axis=-1) * np.maximum(spare, 0.0)
    return groups.RoadParams(
        length_m=length,
        lane_width_m=draw(2.75, 5.0),
        ramp_x_m=(places + order * spaced[..., None]).astype(np.float32),
        acceleration_lane_m=merge,
        exit_lane_m=leave,
        exit_x_m=(
            leave[..., None] + np.sort(exits, axis=-1) * (0.99 * (length - leave))[..., None]
        ).astype(np.float32),
        exit_notice_m=draw(0.0, 1000.0),
        slope=draw(-0.06, 0.06),
        air_density=draw(0.8, 1.4),
    )


def _usual(draw: Draw, group: str, config: EnvConfig) -> dict[str, Any]:
    """The numbers of a group in USUAL."""
    shapes = {
        "": (),
        "kind": KIND,
        "ramp": (config.num_ramps,),
        "exit": (config.num_exits,),
        "period": (config.num_periods, 1 + config.num_ramps),
        "incident": (config.num_incidents,),
    }
    return {
        name: how(draw) if callable(how) else draw(*how, *shapes[groups.GROUPS[group][name].per])
        for name, how in USUAL[group].items()
    }


def _demand(draw: Draw, config: EnvConfig) -> groups.DemandParams:
    soc: Any = np.sort(draw(0.0, 1.0, 2), axis=-1)
    surges: Any = np.sort(draw(0.0, 60.0, 2), axis=-1)
    return groups.DemandParams(
        surge_from_s=surges[..., 0],
        surge_until_s=surges[..., 1],
        arrival_soc_low=soc[..., 0],
        arrival_soc_high=soc[..., 1],
        mainline_per_h=draw(0.0, SATURATED_PER_H * config.num_lanes),
        **_usual(draw, "demand", config),
    )


def _charging(draw: Draw, config: EnvConfig) -> groups.ChargingParams:
    soc: Any = np.sort(draw(0.0, 1.0, 2), axis=-1)
    numbers = _usual(draw, "charging", config)
    return groups.ChargingParams(request_soc=soc[..., 0], target_soc=soc[..., 1], **numbers)


def _incidents(draw: Draw, config: EnvConfig, length_m: Any) -> groups.IncidentParams:
    number = config.num_incidents
    times: Any = np.sort(draw(0.0, 120.0, 2, number), axis=-2)
    places = np.sort(draw(0.0, 1.0, 2, number), axis=-2) * np.asarray(length_m)[..., None, None]
    lanes: Any = np.floor(draw(-1.0, config.num_lanes, number))
    return groups.IncidentParams(
        incident_from_s=times[..., 0, :],
        incident_until_s=times[..., 1, :],
        incident_from_x_m=places[..., 0, :],
        incident_until_x_m=places[..., 1, :],
        incident_lane=lanes.clip(-1, config.num_lanes - 1).astype(np.int32),
        incident_s=draw(0.0, 120.0, number),
    )


def _body(draw: Draw, mass: tuple[float, float], area: float, pack: float) -> groups.BodyParams:
    return groups.BodyParams(
        mass_kg=draw(*mass),
        drag_coefficient=draw(0.1, 1.0),
        frontal_area_m2=draw(0.5 * area, area),
        rolling_resistance=draw(0.004, 0.02),
        rotational_inertia_factor=draw(1.0, 1.2),
        drivetrain_efficiency=draw(0.3, 1.0),
        regeneration_efficiency=draw(0.0, 1.0),
        auxiliary_w=draw(0.0, 5000.0),
        pack_j=draw(0.05 * pack * J_PER_KWH, pack * J_PER_KWH),
    )


def _sometimes(draw: Draw, strange: Any, usual: Any) -> Any:
    """`strange` in one world in ten, else `usual`, `(batch, ...)` float32."""
    return in_worlds(draw(0.0, 1.0) < 0.1, strange, usual)


def _or_inf(draw: Draw, value: Any) -> Any:
    """Infinity in three worlds in ten, else the value."""
    return np.where(draw(0.0, 1.0) < 0.3, np.float32(math.inf), value)


def draw_params(units: Units, config: EnvConfig, table: InductanceTable) -> EnvParams:
    """All numbers of a batch of worlds, as NumPy arrays with the batch axes of `units`; the worlds share `table`."""
    draw = Draw(units)
    once = draw(0.0, 1.0) < 0.5  # in half of the worlds MEDs never return to service
    turnaround: Any = np.where(once, np.float32(math.inf), draw(0.0, 120.0))
    road = _road(draw, config)
    params = EnvParams(
        road=road,
        demand=_demand(draw, config),
        drivers=groups.DriverParams(**_usual(draw, "drivers", config)),
        motion=groups.MotionParams(**_usual(draw, "motion", config)),
        lane_change=groups.LaneChangeParams(**_usual(draw, "lane_change", config)),
        fleet=groups.FleetParams(
            size=draw.whole(0, config.num_meds),
            cooldown_s=draw(0.0, 30.0),
            turnaround_s=turnaround,
            service_speed=draw(5.0, 35.0),
            service_lane=draw.whole(0, config.num_lanes - 1),
            reserve_soc=draw(0.0, 1.0),
            depot_power_w=_or_inf(draw, draw(50e3, 5e6)),
            trip_m=_or_inf(draw, draw(0.0, 3000.0)),
            return_speed=draw(1.0, 100.0),
        ),
        charging=_charging(draw, config),
        link=groups.LinkParams(inductance=table, **_usual(draw, "link", config)),
        incidents=_incidents(draw, config, road.length_m),
        ev=_body(draw, (500.0, 3000.0), 4.0, 100.0),
        med=_body(draw, (4000.0, 40000.0), 12.0, 600.0),
        market=MarketParams(hourly_price=draw(-1.0, 3.0, HOURS_OF_DAY)),
        battery_scale=draw(1.0, 100.0),
        reward_weights={term: draw(-20.0, 20.0) for term in TERMS},
        # So many that an episode ends only where the program that plays it stops.
        episode_decisions=draw.whole(10**6, 10**6),
    )
    return with_anything(draw, params)


def _with_table(params: EnvParams, table: InductanceTable | None) -> EnvParams:
    return params.replace(link=params.link.replace(inductance=table))


def world_of(params: EnvParams, index: int) -> EnvParams:
    """One world of a batch."""
    one = jax.tree.map(operator.itemgetter(index), _with_table(params, None))
    return _with_table(one, params.link.inductance)


def as_overrides(config: EnvConfig, params: EnvParams) -> dict[str, Any]:
    """Keyword arguments with which `medjax.make("paper", ...)` rebuilds this world bit for bit."""

    def plain(value: Any) -> Any:
        value = np.asarray(value)
        if value.ndim:
            return [plain(entry) for entry in value]
        return int(value) if value.dtype == np.int32 else float(str(value))

    leaves = jax.tree_util.tree_leaves_with_path(_with_table(params, None))
    return dataclasses.asdict(config) | {
        jax.tree_util.keystr(path, simple=True, separator="."): plain(value)
        for path, value in leaves
    }


def as_settings(config: EnvConfig, params: EnvParams) -> list[str]:
    """`as_overrides` as texts `NAME=VALUE` for `--set`."""
    return [f"{name}={json.dumps(value)}" for name, value in as_overrides(config, params).items()]


def validated(config: EnvConfig, params: EnvParams, worlds: int | None = None) -> EnvParams:
    """Checks all worlds of a batch, or the first `worlds`; returns the batch. Raises InputError for an invalid one."""
    for index in range(worlds or len(np.asarray(params.battery_scale))):
        world = world_of(params, index)
        validate(config, jax.tree.map(lambda x: x.item() if np.ndim(x) == 0 else x, world))
    return params
