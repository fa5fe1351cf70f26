"""Named presets, and `make`, which builds an environment from one of them.

Every number that is not in the paper is listed with its source in docs/parameters.md.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from medjax.env.charging_env import ChargingEnv
from medjax.env.observation import OBSERVATIONS
from medjax.env.reward import TERMS, RewardTerm
from medjax.errors import MOST_SHOWN, shown
from medjax.physics import tabulate_inductance
from medjax.world.limits import Limits, read_number
from medjax.world.params import (
    BodyParams,
    ChargingParams,
    DemandParams,
    DriverParams,
    EnvConfig,
    EnvParams,
    FleetParams,
    LaneChangeParams,
    LinkParams,
    MotionParams,
    RoadParams,
    check_numbers,
)
from medjax.world.ranges import COILS, GROUPS, OTHERS, SIZES

JOULES_PER_KWH = 3.6e6


@dataclasses.dataclass(frozen=True)
class CoilDesign:
    """The coils of both sides; `build_link` tabulates their mutual inductance."""

    med_coil_radius_m: float = 0.35
    ev_coil_radius_m: float = 0.30
    med_coil_turns: int = 10
    ev_coil_turns: int = 10


def build_link(design: CoilDesign, params: LinkParams | None = None) -> LinkParams:
    """Link of a coil design; pure in the design's numbers, so that it may run under `jax.vmap`.

    Args:
      design: the coils.
      params: everything else of the link; None takes the defaults.
    """
    table = tabulate_inductance(
        design.med_coil_radius_m,
        design.ev_coil_radius_m,
        primary_turns=design.med_coil_turns,
        secondary_turns=design.ev_coil_turns,
    )
    return (params or LINK).replace(inductance=table)


LINK = LinkParams(
    inductance=None,  # type: ignore[arg-type]  # `build_link` fills it in
    panel_gap_m=0.2,
    misalignment_scale=1.0,
    load_ohm=10.0,
    med_resistance_ohm=0.159,
    ev_resistance_ohm=0.126,
    angular_frequency=2.0 * math.pi * 85e3,
)

NISSAN_LEAF = BodyParams(  # 30 kWh (reference: ev_energy.csv)
    mass_kg=1636.03,
    drag_coefficient=0.315,
    frontal_area_m2=2.755,
    rolling_resistance=0.008,
    rotational_inertia_factor=1.01765,
    drivetrain_efficiency=0.90,
    regeneration_efficiency=0.6,
    auxiliary_w=250.0,
    pack_j=30.0 * JOULES_PER_KWH,
)
TRUCK = BodyParams(
    mass_kg=15076.0,
    drag_coefficient=0.8,
    frontal_area_m2=10.0,
    rolling_resistance=0.0092,
    rotational_inertia_factor=1.01765,
    drivetrain_efficiency=0.90,
    regeneration_efficiency=0.6,
    auxiliary_w=1000.0,
    pack_j=400.0 * JOULES_PER_KWH,
)

CHARGING = ChargingParams(
    request_soc=0.4,
    target_soc=0.8,
    reach_ahead_m=400.0,
    reach_behind_m=100.0,
    patience_s=60.0,
    retry_s=10.0,
    approach_speed=8.0,
    approach_rate=0.35,
    speed_rate=1.0,
    platoon_headway=0.3,
    platoon_min_gap=2.0,
    dock_gap_m=12.0,
    dock_tolerance_m=0.3,
    dock_speed_tolerance=0.5,
    hold_tolerance_m=0.6,
    slot_power_w=40e3,
)


def _drivers() -> DriverParams:
    # Columns: MED, human-driven EV, autonomous EV, gas vehicle.
    def kinds(*values: float) -> Any:
        return np.asarray(values, np.float32)

    return DriverParams(
        desired_speed=kinds(25.0, 30.0, 30.0, 30.0),
        desired_speed_std=kinds(0.0, 2.0, 1.0, 2.0),
        time_headway=kinds(1.5, 1.4, 1.2, 1.4),
        min_gap=kinds(3.0, 2.0, 2.0, 2.0),
        max_acceleration=kinds(1.0, 1.4, 1.4, 1.4),
        comfortable_deceleration=kinds(2.0, 2.0, 2.0, 2.0),
        acceleration_noise=kinds(0.02, 0.10, 0.01, 0.10),
        lateral_wander=kinds(0.02, 0.15, 0.02, 0.15),
        vehicle_length=kinds(12.0, 5.0, 5.0, 5.0),
    )


def _paper(config: EnvConfig) -> EnvParams:
    """The paper's corridor: batteries scaled so that charge matters within 4 km."""
    length_m = 4000.0
    ramps: Any = np.array([100, 1200, 2100, 3200], np.float32)
    if config.num_ramps != len(ramps):
        ramps = np.linspace(100, 0.8 * length_m, config.num_ramps, dtype=np.float32)
    return EnvParams(
        road=RoadParams(
            length_m=length_m,
            lane_width_m=4.0,
            ramp_x_m=ramps,
            acceleration_lane_m=250.0,
        ),
        demand=DemandParams(
            mainline_per_h=2600.0,
            ramp_per_h=np.full_like(ramps, 250.0),
            ev_share=0.12,
            human_share=0.5,
            arrival_soc_low=0.2,
            arrival_soc_high=0.7,
            ramp_speed=20.0,
        ),
        drivers=_drivers(),
        motion=MotionParams(max_braking=9.0, noise_time_s=5.0, lateral_rate=2.0),
        lane_change=LaneChangeParams(
            politeness=0.2,
            threshold=0.2,
            right_bias=0.0,
            safe_braking=4.0,
            mandatory_bias=10.0,
            urgency_bias=10.0,
        ),
        fleet=FleetParams(
            size=min(15, config.num_meds),
            cooldown_s=5.0,
            turnaround_s=math.inf,
            service_speed=18.0,
            service_lane=max(0, min(2, config.num_lanes - 2)),
            reserve_soc=0.1,
        ),
        charging=CHARGING,
        link=LINK,
        ev=NISSAN_LEAF,
        med=TRUCK,
        battery_scale=30.0,
        reward_weights={
            "depleted": -11.9,
            "soc": 0.87,
            "distance": 0.087,
            "speed": 0.087,
            "dispatches": 0.0,
            "gas_delay": 0.0,
            "lane_changes": 0.0,
            "collisions": 0.0,
            "transfer_loss": 0.0,
        },
        episode_decisions=600,
    )


def _realistic(config: EnvConfig) -> EnvParams:
    """True packs: EVs arrive with little energy left above empty, so some cannot cross 4 km."""
    params = _paper(config)
    return params.replace(
        battery_scale=1.0,
        demand=params.demand.replace(arrival_soc_low=0.005, arrival_soc_high=0.05),
        charging=params.charging.replace(request_soc=0.02, target_soc=0.06),
    )


def _long(config: EnvConfig) -> EnvParams:
    """A motorway of 100 km with true packs: the way takes a Leaf 18 kWh, and charging it 40 km."""
    params = _paper(config)
    ramps = np.linspace(100.0, 84_100.0, config.num_ramps)  # every 12 km
    return params.replace(
        road=params.road.replace(length_m=100_000.0, ramp_x_m=jnp.asarray(ramps, jnp.float32)),
        demand=params.demand.replace(
            mainline_per_h=1100.0, ramp_per_h=jnp.full((config.num_ramps,), 175.0)
        ),
        fleet=params.fleet.replace(size=config.num_meds),
        battery_scale=1.0,
        episode_decisions=3600,
    )


@dataclasses.dataclass(frozen=True)
class Scenario:
    """A preset: static sizes and a function from them to the numbers, all but the coils' table."""

    config: EnvConfig
    params: Callable[[EnvConfig], EnvParams]


SCENARIOS: dict[str, Scenario] = {
    "paper": Scenario(EnvConfig(), _paper),
    "realistic": Scenario(EnvConfig(), _realistic),
    "long": Scenario(EnvConfig(num_meds=64, num_evs=400, num_gas=2048, num_ramps=8), _long),
}


@dataclasses.dataclass(frozen=True)
class Recipe:
    """How `medjax.make` was called: enough to call it again."""

    scenario: str
    overrides: Mapping[str, Any]
    reward: Mapping[str, Any] | None  # as given
    observation: Any  # as given: a name, or one of one's own


def _places() -> dict[str, tuple[str, str, Limits]]:
    """Group, name and limits of every number, by the names that an override may use.

    A number's own name serves where it is the only one of that name (`cooldown_s`), else it needs its group's
    (`ev.mass_kg`).
    """
    found = {name: [("", name, limits)] for name, limits in OTHERS.items()}
    for group, ranges in GROUPS.items():
        for name, limits in ranges.items():
            for known_as in (name, f"{group}.{name}"):
                found.setdefault(known_as, []).append((group, name, limits))
    return {name: places[0] for name, places in found.items() if len(places) == 1}


PLACES = _places()


def _set(params: EnvParams, overrides: Mapping[str, Any]) -> EnvParams:
    """Params with numbers replaced; a scalar given for an array fills it."""
    names: dict[tuple[str, str], str] = {}
    for key, value in overrides.items():
        group, name, limits = PLACES[key]
        if (other := names.setdefault((group, name), key)) != key:
            raise ValueError(f"{key} and {other} are the same number: allowed one of the two")
        holder: Any = getattr(params, group) if group else params
        shape = np.shape(getattr(holder, name))
        number = read_number(key, value, limits, shape, fill=True, convert=True)
        changed = holder.replace(**{name: number})
        params = params.replace(**{group: changed}) if group else changed
    return params


def _weights(changes: Mapping[Any, Any], weights: Mapping[str, Any]) -> dict[str, Any]:
    """Weights of the reward's terms, some of them replaced."""
    for term in changes:
        if term not in weights:
            raise _unknown("reward term", term, list(weights))
    return {**weights, **changes}


def _unknown(kind: str, name: Any, allowed: list[str]) -> ValueError:
    close = difflib.get_close_matches(name[:MOST_SHOWN], allowed) if isinstance(name, str) else []
    if close:
        return ValueError(f"unknown {kind} {shown(name)}: did you mean {', '.join(close)}?")
    listed = ", ".join(sorted(allowed)) if len(allowed) < 20 else "the names in docs/parameters.md"
    return ValueError(f"unknown {kind} {shown(name)}: allowed {listed}")


def _terms(reward: Any) -> Mapping[str, RewardTerm]:
    """The reward's terms: those that come with medjax, or one's own."""
    if reward is None:
        return TERMS
    if not isinstance(reward, Mapping):
        raise ValueError(f"reward = {shown(reward)}: allowed functions by name")
    for term, function in reward.items():
        if not isinstance(term, str) or not callable(function):
            raise ValueError(f"reward[{shown(term)}] = {shown(function)}: allowed a function")
    return reward


def _observation(given: Any) -> Any:
    """An observation, by its name or as it is."""
    if isinstance(given, str):
        if given not in OBSERVATIONS:
            raise _unknown("observation", given, list(OBSERVATIONS))
        return OBSERVATIONS[given]
    if not callable(given) or not callable(getattr(given, "size", None)):
        allowed = f"{', '.join(OBSERVATIONS)}, or one of your own"
        raise ValueError(f"observation = {shown(given)}: allowed {allowed}")
    return given


def prepare(
    name: str = "paper",
    *,
    reward: Mapping[str, RewardTerm] | None = None,
    observation: Any = "flat",
    **overrides: Any,
) -> tuple[ChargingEnv, EnvParams, CoilDesign]:
    """What `make` builds, all but the coils' table: everything is checked, nothing is computed or compiled.

    Returns:
      (env, params without the table, coils); numbers are NumPy arrays of float32 and int32.

    Raises:
      ValueError: as `make`.
    """
    if not isinstance(name, str) or name not in SCENARIOS:
        raise _unknown("scenario", name, list(SCENARIOS))
    terms, seen = _terms(reward), _observation(observation)
    sizes: dict[str, Any] = {}
    numbers: dict[str, Any] = {}
    coils: dict[str, Any] = {}
    weights: dict[Any, Any] = {}
    for key, value in overrides.items():
        if key in SIZES:
            sizes[key] = value
        elif key in COILS:
            read_number(key, value, COILS[key])
            coils[key] = np.asarray(value).item()
        elif key in PLACES:
            numbers[key] = value
        elif key == "reward_weights":
            if not isinstance(value, Mapping):
                raise ValueError(f"{key} = {shown(value)}: allowed numbers by name of the term")
            weights |= value
        elif key.startswith("reward_weights."):
            weights[key.removeprefix("reward_weights.")] = value
        else:
            raise _unknown("option", key, [*PLACES, *SIZES, *COILS, "reward_weights"])
    ramp_x_m: Any = numbers.get("ramp_x_m", numbers.get("road.ramp_x_m"))
    if isinstance(ramp_x_m, list | tuple) or getattr(ramp_x_m, "ndim", 0) == 1:
        sizes.setdefault("num_ramps", len(ramp_x_m))

    scenario = SCENARIOS[name]
    config = dataclasses.replace(scenario.config, **sizes)
    params = scenario.params(config)
    known = {term: params.reward_weights.get(term, 1.0) for term in terms}
    params = _set(params.replace(reward_weights=_weights(weights, known)), numbers)
    params = check_numbers(config, params)
    env = ChargingEnv(config, reward=terms, observation=seen, name=name)
    env.recipe = Recipe(name, dict(overrides), reward, observation)
    return env, params, CoilDesign(**coils)


def make(
    name: str = "paper",
    *,
    reward: Mapping[str, RewardTerm] | None = None,
    observation: Any = "flat",
    **overrides: Any,
) -> tuple[ChargingEnv, EnvParams]:
    """Builds a preset, with numbers changed by name.

    Args:
      name: one of `SCENARIOS`.
      reward: terms by name; those that come with medjax if None. A term that `reward_weights` of the
        preset does not know gets weight 1.
      observation: a name of `medjax.env.observation.OBSERVATIONS`, or one of your own (`ChargingEnv`).
      **overrides: sizes of `EnvConfig` (`num_evs=80`), numbers of `EnvParams` by their own name
        (`cooldown_s=30`), by group and name where that is not unique (`{"ev.mass_kg": 2000}`), the
        coils (`med_coil_radius_m=0.4`), or `reward_weights={"dispatches": -1.0}`. `ramp_x_m` says
        how many ramps there are where `num_ramps` does not.

    Returns:
      (env, params); params are float32 and int32 arrays, ready to be batched.

    Raises:
      ValueError: one line; an unknown scenario or name, or a value that is not allowed.
    """
    env, params, coils = prepare(name, reward=reward, observation=observation, **overrides)
    link = build_link(coils, params.link)
    table = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), link.inductance)
    params = params.replace(link=link.replace(inductance=table))
    return env, jax.tree.map(jnp.asarray, params)
