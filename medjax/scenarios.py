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

from medjax.config import (
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
    validate,
    validate_config,
)
from medjax.env import ChargingEnv
from medjax.observation import OBSERVATIONS
from medjax.physics import tabulate_inductance
from medjax.reward import TERMS, RewardTerm

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
    if params is not None:
        return params.replace(inductance=table)
    return LinkParams(
        inductance=table,
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
    def kinds(*values: float) -> jax.Array:
        return jnp.asarray(values, jnp.float32)

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
    ramps = [100.0, 1200.0, 2100.0, 3200.0]
    if config.num_ramps != len(ramps):
        ramps = list(np.linspace(100.0, 0.8 * length_m, config.num_ramps))
    return EnvParams(
        road=RoadParams(
            length_m=length_m,
            lane_width_m=4.0,
            ramp_x_m=jnp.asarray(ramps, jnp.float32),
            acceleration_lane_m=250.0,
        ),
        demand=DemandParams(
            mainline_per_h=2600.0,
            ramp_per_h=jnp.full((config.num_ramps,), 250.0),
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
        link=build_link(CoilDesign()),
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
    """A preset: static sizes and a function from them to the numbers."""

    config: EnvConfig
    params: Callable[[EnvConfig], EnvParams]


SCENARIOS: dict[str, Scenario] = {
    "paper": Scenario(EnvConfig(), _paper),
    "realistic": Scenario(EnvConfig(), _realistic),
    "long": Scenario(EnvConfig(num_meds=64, num_evs=400, num_gas=2048, num_ramps=8), _long),
}

_CONFIG_FIELDS = {field.name for field in dataclasses.fields(EnvConfig)}
_COIL_FIELDS = {field.name for field in dataclasses.fields(CoilDesign)}


def _places(params: EnvParams) -> dict[str, tuple[str, ...]]:
    """Path of every number by the names that an override may use: `cooldown_s`, `ev.mass_kg`.

    A leaf's own name serves where it is the only one of that name, else it needs its group's.
    """
    found: dict[str, list[tuple[str, ...]]] = {}
    for group in dataclasses.fields(params):
        member = getattr(params, group.name)
        if isinstance(member, Mapping):
            leaves = list(member)
        elif dataclasses.is_dataclass(member):
            leaves = [leaf.name for leaf in dataclasses.fields(member) if leaf.name != "inductance"]
        else:
            found.setdefault(group.name, []).append((group.name,))
            continue
        for leaf in leaves:
            path = (group.name, leaf)
            found.setdefault(".".join(path), []).append(path)
            if group.name != "reward_weights":
                found.setdefault(leaf, []).append(path)
    return {name: paths[0] for name, paths in found.items() if len(paths) == 1}


def _set(params: EnvParams, name: str, path: tuple[str, ...], value: Any) -> EnvParams:
    """Params with the number at path replaced; a scalar given for an array fills it."""
    *groups, leaf = path
    holder = getattr(params, groups[0]) if groups else params
    old = holder[leaf] if isinstance(holder, Mapping) else getattr(holder, leaf)
    try:
        new = np.asarray(value, np.int32 if isinstance(old, int) else np.float32)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} = {value!r}: allowed a number") from None
    if isinstance(old, int) and not np.array_equal(new, np.asarray(value)):
        raise ValueError(f"{name} = {value!r}: allowed a whole number")
    if new.ndim > np.ndim(old):
        raise ValueError(f"{name} has shape {new.shape}: allowed {np.shape(old)}")
    new = np.broadcast_to(new, np.shape(old)) if new.ndim < np.ndim(old) else new
    number = new if np.ndim(old) else new.item()
    if not groups:
        return params.replace(**{leaf: number})
    if isinstance(holder, Mapping):
        return params.replace(**{groups[0]: {**holder, leaf: number}})
    return params.replace(**{groups[0]: holder.replace(**{leaf: number})})


def _unknown(kind: str, name: str, allowed: list[str]) -> ValueError:
    close = difflib.get_close_matches(name, allowed, n=3)
    if close:
        return ValueError(f"unknown {kind} {name!r}: did you mean {', '.join(close)}?")
    listed = ", ".join(sorted(allowed)) if len(allowed) < 20 else "the names in docs/parameters.md"
    return ValueError(f"unknown {kind} {name!r}: allowed {listed}")


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
      observation: a name of `medjax.observation.OBSERVATIONS`, or one of your own (`ChargingEnv`).
      **overrides: sizes of `EnvConfig` (`num_evs=80`), numbers of `EnvParams` by their own name
        (`cooldown_s=30`), by group and name where that is not unique (`{"ev.mass_kg": 2000}`), the
        coils (`med_coil_radius_m=0.4`), or `reward_weights={"dispatches": -1.0}`. `ramp_x_m` says
        how many ramps there are where `num_ramps` does not.

    Returns:
      (env, params); params are float32 and int32 arrays, ready to be batched.

    Raises:
      ValueError: one line; an unknown scenario or name, or a value that is not allowed.
    """
    if name not in SCENARIOS:
        raise _unknown("scenario", name, list(SCENARIOS))
    if isinstance(observation, str):
        if observation not in OBSERVATIONS:
            raise _unknown("observation", observation, list(OBSERVATIONS))
        observation = OBSERVATIONS[observation]
    scenario = SCENARIOS[name]
    sizes = {key: overrides.pop(key) for key in list(overrides) if key in _CONFIG_FIELDS}
    coils = {key: overrides.pop(key) for key in list(overrides) if key in _COIL_FIELDS}
    weights = overrides.pop("reward_weights", {})
    ramp_x_m: Any = overrides.get("ramp_x_m", overrides.get("road.ramp_x_m"))
    if isinstance(ramp_x_m, list | tuple) or getattr(ramp_x_m, "ndim", 0) == 1:
        sizes.setdefault("num_ramps", len(ramp_x_m))
    config = dataclasses.replace(scenario.config, **sizes)
    validate_config(config)
    params = scenario.params(config)

    terms = TERMS if reward is None else reward
    known = {term: params.reward_weights.get(term, 1.0) for term in terms}
    params = params.replace(reward_weights=known)
    for term, weight in weights.items():
        if term not in known:
            raise _unknown("reward term", term, list(known))
        overrides[f"reward_weights.{term}"] = weight

    places = _places(params)
    for key, value in overrides.items():
        if key not in places:
            raise _unknown("option", key, [*places, *_CONFIG_FIELDS, *_COIL_FIELDS])
        params = _set(params, key, places[key], value)
    validate(config, params)
    if coils:
        params = params.replace(link=build_link(_coil_design(coils), params.link))
    env = ChargingEnv(config, reward=terms, observation=observation, name=name)
    return env, jax.tree.map(_as_array, params)


def _coil_design(coils: dict[str, Any]) -> CoilDesign:
    for key, value in coils.items():
        if not isinstance(value, int | float) or not 0.0 < value < math.inf:
            raise ValueError(f"{key} = {value!r}: allowed (0, inf)")
    return CoilDesign(**coils)


def _as_array(leaf: Any) -> jax.Array:
    """A strongly typed array, so that no literal's weak type reaches a scan's carry."""
    return jnp.asarray(leaf, jnp.int32 if isinstance(leaf, int) else jnp.float32)
