"""Named presets: `paper` is the default of every number, and the others list their differences from it.

`PLACES` holds the names by which presets and `medjax.make` change numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from medjax.errors import InputError
from medjax.world import freight
from medjax.world.catalogue import ABOUT, listed
from medjax.world.incident_params import IncidentParams
from medjax.world.numbers import read_number
from medjax.world.params import GROUPS, OTHERS, EnvConfig, EnvParams


def _places() -> dict[str, tuple[str, str]]:
    """Group and name of every number, by the names that an override may use.

    A unique name stands alone (`cooldown_s`); others need their group (`ev.mass_kg`).
    """
    found = {name: [("", name)] for name in OTHERS}
    for group, numbers in GROUPS.items():
        for name in numbers:
            for known_as in (name, f"{group}.{name}"):
                found.setdefault(known_as, []).append((group, name))
    return {name: places[0] for name, places in found.items() if len(places) == 1}


PLACES = _places()

# Overrides that bound what `_fit` places and times by default.
BOUNDS = ("length_m", "road.length_m", "episode_decisions")
# Default where only the number or places of exits are given: an interchange every 6 km and mean trips of 60 km.
EXIT_SHARE = 0.1
# Likewise where only the number of incidents is given.
INCIDENT = {"from_s": 120.0, "until_s": 300.0, "s": 300.0, "lane": -1}


def _put(params: EnvParams, place: tuple[str, str], value: Any) -> EnvParams:
    """Replaces one number without checking it."""
    group, name = place
    if not group:
        return params.replace(**{name: value})
    return params.replace(**{group: getattr(params, group).replace(**{name: value})})


def change_numbers(params: EnvParams, overrides: Mapping[str, Any]) -> EnvParams:
    """Replaces numbers by the names of `PLACES`; a scalar fills a whole array.

    Raises:
      InputError: a value is not allowed, or a number is given under both of its names.
    """
    names: dict[tuple[str, str], str] = {}
    for key, value in overrides.items():
        place = group, name = PLACES[key]
        if (other := names.setdefault(place, key)) != key:
            raise InputError(f"{key} and {other} are the same number: allowed one of the two")
        shape = np.shape(getattr(getattr(params, group) if group else params, name))
        declared = GROUPS[group][name] if group else OTHERS[name]
        number = read_number(key, value, declared, shape, fill=True, convert=True)
        params = _put(params, place, number)
    return params


def _profile(given: Any, config: EnvConfig) -> np.ndarray:
    """The profile for these sizes: rows repeat from the start, and extra ramps repeat the last column."""
    rows = np.resize(np.float32(given), (config.num_periods, np.shape(given)[1]))
    columns = np.minimum(np.arange(1 + config.num_ramps), rows.shape[1] - 1)
    return rows[:, columns]


def _incidents(params: EnvParams, config: EnvConfig) -> IncidentParams:
    """The incidents of a preset, repeated to their number; by default in the middle half of the road."""
    number, quarter = config.num_incidents, 0.25 * params.road.length_m
    usual = INCIDENT | {"from_x_m": quarter, "until_x_m": 3.0 * quarter}
    end_s = float(params.episode_decisions) * config.decision_s
    usual |= {name: min(usual[name], end_s) for name in ("from_s", "until_s")}
    fitted: dict[str, Any] = {}
    for name, value in usual.items():
        values = np.ravel(getattr(params.incidents, f"incident_{name}"))
        fitted[f"incident_{name}"] = np.resize(values if len(values) else value, number)
    return IncidentParams(**fitted)


def _fit(params: EnvParams, config: EnvConfig, own: EnvConfig) -> EnvParams:
    """Fits params of a preset with sizes `own` to other sizes.

    The number of ramps and exits changes, the fleet shrinks to the MED slots, and on fewer lanes the service lane keeps
    its distance from the rightmost lane.
    """
    road, demand, fleet = params.road, params.demand, params.fleet
    exits, shares = (np.asarray(x, np.float32) for x in (road.exit_x_m, demand.exit_share))
    if len(exits) != config.num_exits:
        exits = np.linspace(0.0, road.length_m, config.num_exits + 2, dtype=np.float32)[1:-1]
    if len(shares) != config.num_exits:
        shares = np.resize(shares if len(shares) else np.float32(EXIT_SHARE), config.num_exits)
    places, ramps = np.asarray(road.ramp_x_m, np.float32), config.num_ramps
    if len(places) != ramps:
        places = np.linspace(places[0], places[-1], ramps, dtype=np.float32)
    lane = int(fleet.service_lane)
    lane = max(0, min(lane, config.num_lanes - (own.num_lanes - lane)))
    return params.replace(
        road=road.replace(ramp_x_m=places, exit_x_m=exits),
        demand=demand.replace(
            ramp_per_h=np.resize(np.float32(demand.ramp_per_h), ramps),
            exit_share=shares,
            profile=_profile(demand.profile, config),
        ),
        incidents=_incidents(params, config),
        fleet=fleet.replace(size=min(int(fleet.size), config.num_meds), service_lane=lane),
    )


@dataclasses.dataclass(frozen=True)
class Scenario:
    """A preset: sizes, numbers that differ from `paper` (by the names of `PLACES`), and a reward."""

    about: str  # one-line description
    config: EnvConfig = dataclasses.field(default_factory=EnvConfig)
    numbers: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    reward: str = "paper"  # name in `medjax.env.reward.REWARDS`
    prices: Mapping[str, float] = dataclasses.field(default_factory=dict)  # weights that differ
    # Numbers of the rule `budgeted` that `benchmarks.tune` found best here; those of `paper` are in its code.
    budget: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def params(self, config: EnvConfig, overrides: Mapping[str, Any] | None = None) -> EnvParams:
        """The numbers for these sizes, without the coils' table.

        Of the overrides it takes those that bound default places and times: the road's length and the episode's.

        Raises:
          InputError: one of these two is not allowed.
        """
        params = EnvParams()
        for name, value in self.numbers.items():
            params = _put(params, PLACES[name], value)
        given = {name: value for name, value in (overrides or {}).items() if name in BOUNDS}
        params = change_numbers(params, given)
        params = params.replace(reward_weights=params.reward_weights | dict(self.prices))
        return _fit(params, config, self.config)


class Presets(dict[str, Scenario]):
    """Presets by name; printed as one line each."""

    def __repr__(self) -> str:
        return listed({name: preset.about for name, preset in self.items()})


SCENARIOS = Presets(
    paper=Scenario(ABOUT["paper"]),
    realistic=Scenario(
        ABOUT["realistic"],
        numbers={
            "battery_scale": 1.0,
            "arrival_soc_low": 0.005,
            "arrival_soc_high": 0.05,
            "request_soc": 0.02,
            "target_soc": 0.06,
        },
    ),
    long=Scenario(
        ABOUT["long"],
        EnvConfig(num_meds=64, num_evs=400, num_gas=2048, num_ramps=8),
        {
            "length_m": 100_000.0,
            "ramp_x_m": [100.0 + 12_000.0 * ramp for ramp in range(8)],
            "mainline_per_h": 1100.0,
            "ramp_per_h": 175.0,
            "size": 64,
            "battery_scale": 1.0,
            "episode_decisions": 3600,
        },
    ),
)

# Share of a day's vehicles in each hour: Interstate 94 at Minneapolis, westbound, 653 days from Monday to Thursday
# (Metro Interstate Traffic Volume, UCI). The preset scales them to the busiest hour.
HOURS = np.array(
    [
        *(0.0072, 0.0044, 0.0034, 0.0042, 0.0100, 0.0328, 0.0647, 0.0722),
        *(0.0660, 0.0582, 0.0513, 0.0538, 0.0560, 0.0561, 0.0596, 0.0655),
        *(0.0741, 0.0692, 0.0518, 0.0379, 0.0330, 0.0307, 0.0234, 0.0146),
    ]
)
INTERCHANGES_M = 3_000.0 + 6_000.0 * np.arange(5)

SCENARIOS["corridor"] = Scenario(  # docs/parameters.md has the reasons
    ABOUT["corridor"],
    EnvConfig(
        num_meds=40,
        num_evs=400,
        num_gas=1200,
        num_lanes=3,
        num_ramps=5,
        num_exits=5,
        num_periods=24,
        rounds_per_decision=10,
    ),
    {
        "length_m": 30_000.0,
        "lane_width_m": 3.75,
        "exit_x_m": INTERCHANGES_M - 300.0,
        "ramp_x_m": INTERCHANGES_M + 300.0,
        "exit_share": np.full(5, 0.1),
        "mainline_per_h": 3600.0,
        "ramp_per_h": np.full(5, 360.0),
        "profile": np.repeat(HOURS[:, None] / HOURS.max(), 6, axis=1),
        "start_s": 15.5 * 3600.0,
        "ev_share": 0.25,
        "lorry_share": 0.16,
        "eco_compliance": 0.5,
        "arrival_soc_low": 0.05,
        "arrival_soc_high": 0.9,
        "desired_speed": [23.0, 32.0, 32.0, 32.0, 23.6],
        "desired_speed_std": [0.0, 3.0, 1.0, 3.0, 0.7],
        "max_acceleration": [0.5, 1.4, 1.4, 1.4, 0.5],
        "vehicle_length": [16.5, 4.7, 4.7, 4.7, 16.5],
        "right_bias": 0.3,
        "ev.pack_j": 58.0 * 3.6e6,
        "ev.mass_kg": 1_900.0,
        "ev.drag_coefficient": 0.28,
        "ev.frontal_area_m2": 2.4,
        "med.mass_kg": 25_000.0,
        "med.drag_coefficient": 0.55,
        "med.rolling_resistance": 0.0055,
        "med.auxiliary_w": 3_000.0,
        "med.pack_j": 500.0 * 3.6e6,
        "battery_scale": 1.0,
        "size": 20,
        "cooldown_s": 10.0,
        "service_speed": 23.0,
        "service_lane": 2,
        "turnaround_s": 300.0,
        "depot_power_w": 350e3,
        "trip_m": 20_000.0,
        "slot_power_w": 20e3,
        "request_soc": 0.25,
        "target_soc": 0.5,
        "stop_soc": 0.1,
        "patience_s": 200.0,
        "episode_decisions": 360,
    },
    reward="money",
)

SCENARIOS["freight"] = Scenario(
    ABOUT["freight"],
    EnvConfig(**freight.SIZES),
    {**SCENARIOS["corridor"].numbers, **freight.NUMBERS},
    reward="money",
    prices=freight.PRICES,
    budget=freight.BUDGET,
)


@dataclasses.dataclass(frozen=True)
class Recipe:
    """Arguments of a call to `medjax.make`, enough to repeat it."""

    scenario: str
    # By name; numbers, lists of numbers and `reward_weights`, in JSON types.
    overrides: Mapping[str, Any]
    reward: Any  # as given
    observation: Any  # as given: a name or an object
    following: Any = None  # as given
    coupling: Any = None  # as given
