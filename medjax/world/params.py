"""What an environment is made of: static sizes (EnvConfig) and traced numbers (EnvParams).

EnvConfig holds what changes a compiled program. Every other number is a leaf of EnvParams, so that
`jax.vmap` can run over demands, reward weights, batteries or coil designs in one program. Both are
validated on the host by `validate`; `medjax.make` calls it.

The order of vehicle kinds in every `(num_kinds,)` leaf is that of `medjax.world.kinds.KINDS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.typing import ArrayLike

from medjax.errors import shown
from medjax.physics import InductanceTable
from medjax.world.kinds import CLASSES, KINDS
from medjax.world.limits import Limits, as_numbers, read_number
from medjax.world.ranges import GROUPS, OTHERS, SIZES, WEIGHT

PANELS = ("left", "right", "rear", "front")
LEFT, RIGHT, REAR, FRONT = range(4)

Scalar = jax.Array | float


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """Sizes and cadences that fix array shapes and loops; hashable, one compiled program each.

    Vehicle slots are ordered MEDs, EVs, gas vehicles, so each class is a plain slice.

    Raises:
      ValueError: one line that names the field, its value and what is allowed.
    """

    num_meds: int = 15
    num_evs: int = 40
    num_gas: int = 153
    num_lanes: int = 4
    num_ramps: int = 4
    tick_s: float = 0.25
    ticks_per_decision: int = 4

    def __post_init__(self) -> None:
        """Checks the sizes, and keeps them as numbers of Python."""
        for name, limits in SIZES.items():
            value = getattr(self, name)
            number = read_number(name, value, limits)
            object.__setattr__(self, name, number.item() if limits.whole else float(value))
        _check_places(self)

    @property
    def num_vehicles(self) -> int:
        """Slots of all classes."""
        return self.num_meds + self.num_evs + self.num_gas

    @property
    def num_entries(self) -> int:
        """Places where traffic enters: each lane at x = 0, then each ramp."""
        return self.num_lanes + self.num_ramps

    @property
    def num_actions(self) -> int:
        """Action 0 sends none, action r one from ramp r - 1."""
        return 1 + self.num_ramps

    @property
    def decision_s(self) -> float:
        """Seconds between two decisions."""
        return self.tick_s * self.ticks_per_decision

    @property
    def lane_change_groups(self) -> int:
        """Slots are staggered over this many groups so that each looks both ways once a second."""
        return max(1, round(0.5 / self.tick_s))

    @property
    def med_slots(self) -> slice:
        """Slots of MEDs."""
        return slice(0, self.num_meds)

    @property
    def ev_slots(self) -> slice:
        """Slots of EVs."""
        return slice(self.num_meds, self.num_meds + self.num_evs)

    @property
    def gas_slots(self) -> slice:
        """Slots of gas vehicles."""
        return slice(self.num_meds + self.num_evs, self.num_vehicles)

    @property
    def class_slots(self) -> dict[str, slice]:
        """Slots of each class, in the order of `medjax.world.kinds.CLASSES`."""
        return dict(zip(CLASSES, (self.med_slots, self.ev_slots, self.gas_slots), strict=True))

    @property
    def traffic_slots(self) -> slice:
        """Slots of those that come by themselves, EVs before the others: all but MEDs."""
        return slice(self.num_meds, self.num_vehicles)

    def by_slot(self, meds: ArrayLike, evs: ArrayLike, gas: ArrayLike) -> jax.Array:
        """Values of the classes' slots, each `(C,)` or one for all of them, as one array `(num_vehicles,)`."""
        parts = ((meds, self.num_meds), (evs, self.num_evs), (gas, self.num_gas))
        return jnp.concatenate([jnp.broadcast_to(part, (size,)) for part, size in parts])


class RoadParams(struct.PyTreeNode):
    """Geometry of the highway; positions are metres from its left end."""

    length_m: Scalar
    lane_width_m: Scalar
    ramp_x_m: jax.Array  # (num_ramps,) where each acceleration lane starts
    acceleration_lane_m: Scalar


class DemandParams(struct.PyTreeNode):
    """Traffic that asks to enter."""

    mainline_per_h: Scalar  # vehicles per hour over all lanes at x = 0
    ramp_per_h: jax.Array  # (num_ramps,) vehicles per hour
    ev_share: Scalar  # share of arrivals that are EVs
    human_share: Scalar  # share of EVs driven by a human
    arrival_soc_low: Scalar  # state of charge of arriving EVs: uniform between these
    arrival_soc_high: Scalar
    ramp_speed: Scalar  # m/s at the start of an acceleration lane


class DriverParams(struct.PyTreeNode):
    """Car-following and body parameters, each `(num_kinds,)`."""

    desired_speed: jax.Array  # m/s, mean of the kind
    desired_speed_std: jax.Array  # m/s
    time_headway: jax.Array  # s
    min_gap: jax.Array  # m, bumper to bumper
    max_acceleration: jax.Array  # m/s^2
    comfortable_deceleration: jax.Array  # m/s^2
    acceleration_noise: jax.Array  # m/s^2, standard deviation
    lateral_wander: jax.Array  # m, standard deviation
    vehicle_length: jax.Array  # m


class MotionParams(struct.PyTreeNode):
    """Limits and noise shared by all vehicles."""

    max_braking: Scalar  # m/s^2, physical limit of the tyres
    noise_time_s: Scalar  # correlation time of acceleration noise and lateral wander
    lateral_rate: Scalar  # 1/s, natural frequency of the lateral relaxation


class LaneChangeParams(struct.PyTreeNode):
    """MOBIL (Kesting, Treiber, Helbing 2007)."""

    politeness: Scalar
    threshold: Scalar  # m/s^2
    right_bias: Scalar  # m/s^2 in favour of the right lane
    safe_braking: Scalar  # m/s^2 imposed on the new follower or on oneself, at most
    mandatory_bias: Scalar  # m/s^2 added to a mandatory change, at least
    urgency_bias: Scalar  # m/s^2 more at the end of an acceleration lane


class FleetParams(struct.PyTreeNode):
    """The MEDs and their dispatch."""

    size: jax.Array | int  # MEDs at the depot at the start, at most num_meds
    cooldown_s: Scalar  # between two dispatches
    turnaround_s: Scalar  # from leaving the road to being ready again, full; inf: sent once
    service_speed: Scalar  # m/s
    service_lane: jax.Array | int  # lane index, one with a lane on either side
    reserve_soc: Scalar  # a MED keeps this for its way home


class ChargingParams(struct.PyTreeNode):
    """Requests, booking and docking."""

    request_soc: Scalar  # an EV below this asks
    target_soc: Scalar  # and leaves its slot at this
    reach_ahead_m: Scalar  # how far ahead of the EV a MED may be asked
    reach_behind_m: Scalar
    patience_s: Scalar  # a booking that has not docked for so long lapses
    retry_s: Scalar  # then the EV waits so long before it asks again
    approach_speed: Scalar  # m/s relative to the MED, at most
    approach_rate: Scalar  # 1/s, relative speed asked for per metre of distance to go
    speed_rate: Scalar  # 1/s, acceleration per m/s of relative speed error
    platoon_headway: Scalar  # s, between a MED and the EVs booked on it
    platoon_min_gap: Scalar  # m
    dock_gap_m: Scalar  # m, bumper to bumper, in front of and behind a MED
    dock_tolerance_m: Scalar  # within this, and
    dock_speed_tolerance: Scalar  # m/s of the MED's speed, charging starts
    hold_tolerance_m: Scalar  # beyond this it stops
    slot_power_w: Scalar  # drawn from the MED for each charging slot


class LinkParams(struct.PyTreeNode):
    """Coils and the circuit; the table is `physics.tabulate_inductance` of the coil design."""

    inductance: InductanceTable
    panel_gap_m: Scalar  # nominal axial distance of two docked panels
    misalignment_scale: Scalar  # of what is off nominal, how much the coils see; 0: none, 1: all
    load_ohm: Scalar
    med_resistance_ohm: Scalar
    ev_resistance_ohm: Scalar
    angular_frequency: Scalar  # rad/s


class BodyParams(struct.PyTreeNode):
    """Road load and drivetrain of one vehicle class, eqs (7)-(8)."""

    mass_kg: Scalar
    drag_coefficient: Scalar
    frontal_area_m2: Scalar
    rolling_resistance: Scalar
    rotational_inertia_factor: Scalar
    drivetrain_efficiency: Scalar
    regeneration_efficiency: Scalar
    auxiliary_w: Scalar
    pack_j: Scalar  # true battery capacity


class EnvParams(struct.PyTreeNode):
    """Every number of the world; a pytree whose leaves may be traced or batched."""

    road: RoadParams
    demand: DemandParams
    drivers: DriverParams
    motion: MotionParams
    lane_change: LaneChangeParams
    fleet: FleetParams
    charging: ChargingParams
    link: LinkParams
    ev: BodyParams
    med: BodyParams
    battery_scale: Scalar  # divides every battery capacity, never a power
    reward_weights: dict[str, Scalar]  # one a reward term
    episode_decisions: Scalar  # decisions until truncation

    @property
    def ev_capacity_j(self) -> Scalar:
        """Energy of a full EV, J."""
        return _quotient(self.ev.pack_j, self.battery_scale)

    @property
    def med_capacity_j(self) -> Scalar:
        """Energy of a full MED, J."""
        return _quotient(self.med.pack_j, self.battery_scale)


def _quotient(numerator: Scalar, denominator: Scalar) -> Scalar:
    """Numerator / denominator, rounded once: XLA makes x / (a / b) an x b / a where it sees both, not elsewhere."""
    return jax.lax.optimization_barrier(numerator / denominator)


# `medjax.traffic.neighbours` writes all lanes, the acceleration lane and one for nobody, into one line.
MOST_PLACES = 2**16


def validate_config(config: EnvConfig) -> None:
    """Checks that config is one; each checked itself when it was built.

    Raises:
      ValueError: one line.
    """
    if not isinstance(config, EnvConfig):
        raise ValueError(f"config = {shown(config)}: allowed an EnvConfig")


def _check_places(config: EnvConfig) -> None:
    most = MOST_PLACES // (config.num_lanes + 2) - 2
    if config.num_vehicles > most:
        raise ValueError(
            f"num_meds + num_evs + num_gas = {config.num_vehicles}: allowed at most {most} with "
            f"num_lanes = {config.num_lanes}"
        )


def check_numbers(config: EnvConfig, params: EnvParams) -> EnvParams:
    """Checks everything but the coils' table, and computes nothing.

    Returns:
      The params, with every number as a NumPy array of its type and shape.

    Raises:
      ValueError: one line that names the field, its value and what is allowed.
    """
    validate_config(config)
    _check_type("params", params, EnvParams)
    shapes = {"": (), "kind": (len(KINDS),), "ramp": (config.num_ramps,)}

    def read(name: str, value: Any, limits: Limits) -> np.ndarray:
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


def _check_type(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise ValueError(f"{name} = {shown(value)}: allowed {kind.__name__}")


def _check_road(params: EnvParams) -> None:
    road = params.road
    lane_m = float(road.acceleration_lane_m)
    stop_m = float(params.demand.ramp_speed) ** 2 / (2.0 * float(params.motion.max_braking))
    if road.ramp_x_m.size and lane_m < stop_m:
        raise ValueError(
            f"acceleration_lane_m = {lane_m:g}: allowed at least {stop_m:g} m, the way to a stop from ramp_speed"
        )
    last = float(road.length_m) - lane_m
    for x in road.ramp_x_m:
        if x > last:
            raise ValueError(
                f"ramp_x_m = {x:g}: allowed 0 to {last:g} m (road less one merge lane)"
            )
    # Who enters at a ramp reaches back by its length, to where others may stand at the end of the lane before.
    apart_m = lane_m + float(params.drivers.vehicle_length.max())
    if (np.diff(road.ramp_x_m) <= apart_m).any():
        raise ValueError(
            f"ramp_x_m = {shown(road.ramp_x_m.tolist())}: allowed ascending, more than acceleration_lane_m and the "
            f"longest vehicle_length = {apart_m:g} m apart"
        )


def _check_pairs(config: EnvConfig, params: EnvParams) -> None:
    """Numbers that another one bounds."""
    demand, charging, fleet = params.demand, params.charging, params.fleet
    pairs: tuple[tuple[str, Any, str, Any], ...] = (
        ("arrival_soc_low", demand.arrival_soc_low, "arrival_soc_high", demand.arrival_soc_high),
        ("request_soc", charging.request_soc, "target_soc", charging.target_soc),
        ("service_lane", fleet.service_lane, "num_lanes - 1", config.num_lanes - 1),
        ("fleet size", fleet.size, "num_meds", config.num_meds),
    )
    for name, value, bound, most in pairs:
        if value > most:
            raise ValueError(f"{name} = {value:g}: allowed at most {bound} = {most:g}")


def validate(config: EnvConfig, params: EnvParams) -> None:
    """Checks both on the host, for unbatched params.

    Raises:
      ValueError: one line that names the field, its value and what is allowed.
    """
    check_numbers(config, params)
    table = params.link.inductance
    _check_type("link.inductance", table, InductanceTable)
    for name, value in vars(table).items():
        array = as_numbers(value)
        if array is None or array.ndim != 3 * (name == "values") or not np.isfinite(array).all():
            raise ValueError(
                f"link.inductance.{name} = {shown(value)}: allowed what build_link gives"
            )
