"""What an environment is made of: static sizes (EnvConfig) and traced numbers (EnvParams).

EnvConfig holds what changes a compiled program. Every other number is a leaf of EnvParams, so that
`jax.vmap` can run over demands, reward weights, batteries or coil designs in one program. Both are
validated on the host by `validate`; `medjax.make` calls it.

The order of vehicle kinds in every `(num_kinds,)` leaf is MED, human-driven EV, autonomous EV, gas.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import numpy as np
from flax import struct

from medjax.physics import InductanceTable

KINDS = ("MED", "human EV", "autonomous EV", "gas")
MED, HUMAN_EV, AUTONOMOUS_EV, GAS = range(4)

PANELS = ("left", "right", "rear", "front")
LEFT, RIGHT, REAR, FRONT = range(4)

Scalar = jax.Array | float


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """Sizes and cadences that fix array shapes and loops; hashable, one compiled program each.

    Vehicle slots are ordered MEDs, EVs, gas vehicles, so each class is a plain slice.
    """

    num_meds: int = 15
    num_evs: int = 40
    num_gas: int = 153
    num_lanes: int = 4
    num_ramps: int = 4
    tick_s: float = 0.25
    ticks_per_decision: int = 4

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
        return self.ev.pack_j / self.battery_scale

    @property
    def med_capacity_j(self) -> Scalar:
        """Energy of a full MED, J."""
        return self.med.pack_j / self.battery_scale


# (field, lowest, highest) of every bounded number; open ends are None, "!" excludes the bound.
_POSITIVE = (0.0, None, "(0, inf)")
_NON_NEGATIVE = (0.0, None, "[0, inf)")
_SHARE = (0.0, 1.0, "[0, 1]")


def _check(name: str, value: object, low: float, high: float | None, allowed: str) -> None:
    numbers = np.asarray(value, dtype=np.float64)
    bad = ~np.isfinite(numbers) | (numbers < low)
    if allowed.startswith("("):
        bad |= numbers <= low
    if high is not None:
        bad |= numbers > high
    if bad.any():
        raise ValueError(f"{name} = {numbers[bad].flat[0]:g}: allowed {allowed}")


def _check_whole(name: str, value: object, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r}: allowed a whole number {low} to {high}")


def validate_config(config: EnvConfig) -> None:
    """Raises ValueError with one line (field, value, what is allowed)."""
    _check_whole("num_meds", config.num_meds, 1, 64)
    _check_whole("num_evs", config.num_evs, 1, 2048)
    _check_whole("num_gas", config.num_gas, 0, 2048)
    _check_whole("num_lanes", config.num_lanes, 1, 6)
    _check_whole("num_ramps", config.num_ramps, 0, 8)
    _check_whole("ticks_per_decision", config.ticks_per_decision, 1, 100)
    if not isinstance(config.tick_s, float | int) or not 0.02 <= config.tick_s <= 0.5:
        raise ValueError(f"tick_s = {config.tick_s!r}: allowed 0.02 to 0.5 (s)")


_SHARES = {
    "ev_share",
    "human_share",
    "arrival_soc_low",
    "arrival_soc_high",
    "reserve_soc",
    "request_soc",
    "target_soc",
    "politeness",
    "regeneration_efficiency",
}
_MAY_BE_ZERO = {
    "mainline_per_h",
    "ramp_per_h",
    "desired_speed_std",
    "acceleration_noise",
    "lateral_wander",
    "threshold",
    "mandatory_bias",
    "urgency_bias",
    "cooldown_s",
    "size",
    "service_lane",
    "reach_ahead_m",
    "reach_behind_m",
    "retry_s",
    "slot_power_w",
    "misalignment_scale",
    "auxiliary_w",
    "ramp_x_m",
}


def _validate_leaf(group: str, name: str, value: object) -> None:
    label = f"{group}.{name}" if group else name
    if name == "turnaround_s":  # inf: a MED is sent once
        if np.isnan(value) or np.asarray(value) < 0:  # type: ignore[call-overload]
            raise ValueError(f"{label} = {value}: allowed [0, inf]")
    elif name == "right_bias":
        _check(label, value, -math.inf, None, "any finite number")
    elif name == "drivetrain_efficiency":  # divides
        _check(label, value, 0.0, 1.0, "(0, 1]")
    elif name in _SHARES:
        _check(label, value, *_SHARE)
    elif name in _MAY_BE_ZERO:
        _check(label, value, *_NON_NEGATIVE)
    else:
        _check(label, value, *_POSITIVE)


def _validate_road(config: EnvConfig, road: RoadParams, longest_m: float) -> None:
    ramps = np.asarray(road.ramp_x_m, dtype=np.float64)
    if ramps.shape != (config.num_ramps,):
        raise ValueError(f"ramp_x_m has shape {ramps.shape}: allowed ({config.num_ramps},)")
    last = float(road.length_m) - float(road.acceleration_lane_m)
    for x in ramps:
        if not 0.0 <= x <= last:
            raise ValueError(
                f"ramp_x_m = {x:g}: allowed 0 to {last:g} m (road less one merge lane)"
            )
    # Who enters at a ramp reaches back by its length, to where others may stand at the end of the lane before.
    apart = float(road.acceleration_lane_m) + longest_m
    if (np.diff(ramps) <= apart).any():
        raise ValueError(
            f"ramp_x_m = {ramps.tolist()}: allowed ascending, more than acceleration_lane_m and the longest "
            f"vehicle_length = {apart:g} m apart"
        )


def validate(config: EnvConfig, params: EnvParams) -> None:
    """Checks both on the host, for unbatched params.

    Raises:
      ValueError: one line that names the field, its value and what is allowed.
    """
    validate_config(config)
    for group in dataclasses.fields(params):
        member = getattr(params, group.name)
        if group.name == "reward_weights":
            for name, weight in member.items():
                _check(f"reward_weights.{name}", weight, -math.inf, None, "any finite number")
        elif dataclasses.is_dataclass(member):
            for leaf in dataclasses.fields(member):
                value = getattr(member, leaf.name)
                if not isinstance(value, InductanceTable):
                    _validate_leaf(group.name, leaf.name, value)
        else:
            _validate_leaf("", group.name, member)
    _validate_road(config, params.road, float(np.max(params.drivers.vehicle_length)))
    demand, charging = params.demand, params.charging
    if float(demand.arrival_soc_low) > float(demand.arrival_soc_high):
        raise ValueError(
            f"arrival_soc_low = {float(demand.arrival_soc_low):g}: allowed at most "
            f"arrival_soc_high = {float(demand.arrival_soc_high):g}"
        )
    if float(charging.request_soc) > float(charging.target_soc):
        raise ValueError(
            f"request_soc = {float(charging.request_soc):g}: allowed at most "
            f"target_soc = {float(charging.target_soc):g}"
        )
    if not 0 <= int(params.fleet.service_lane) < config.num_lanes:
        raise ValueError(
            f"service_lane = {int(params.fleet.service_lane)}: allowed 0 to {config.num_lanes - 1}"
        )
    if not 0 <= int(params.fleet.size) <= config.num_meds:
        raise ValueError(f"fleet size = {int(params.fleet.size)}: allowed 0 to {config.num_meds}")
    if np.shape(demand.ramp_per_h) != (config.num_ramps,):
        raise ValueError(
            f"ramp_per_h has shape {np.shape(demand.ramp_per_h)}: allowed ({config.num_ramps},)"
        )
