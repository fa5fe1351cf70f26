"""Parameters of fleet, charging, link and vehicle bodies, declared as in `medjax.world.traffic_params`."""

from __future__ import annotations

import dataclasses
import math

import jax
from flax import struct

from medjax.physics import InductanceTable, tabulate_inductance
from medjax.world.numbers import number, numbers_of
from medjax.world.traffic_params import Scalar

JOULES_PER_KWH = 3.6e6


class FleetParams(struct.PyTreeNode):
    """MED fleet and dispatch."""

    size: jax.Array | int = number(
        15, 0, 64, "", "number of MEDs, at most `num_meds`; all start at a depot; paper", whole=True
    )
    cooldown_s: Scalar = number(
        20.0, 0, 1e6, "s", "time between two dispatches; chosen, the paper leaves it to the user"
    )
    turnaround_s: Scalar = number(
        math.inf,
        0,
        math.inf,
        "s",
        "time from the road to a depot's charger, plus from there to its ramp; inf: each MED is sent once",
    )
    depot_power_w: Scalar = number(
        math.inf,
        1.0,
        math.inf,
        "W",
        "charging power of a MED at a depot; inf: charged at once; paper",
    )
    return_speed: Scalar = number(
        22.0,
        1,
        100,
        "m/s",
        "speed of a MED on the way from the road to its depot, if there are several; a lorry's speed",
    )
    trip_m: Scalar = number(
        math.inf,
        0,
        math.inf,
        "m",
        "a MED leaves at the first exit after this distance or at `reserve_soc`; without exits at the road's end",
    )
    service_speed: Scalar = number(
        22.0,
        1,
        100,
        "m/s",
        "a lorry's speed; with it, the best rule achieves what the paper claims (docs/paper.md)",
    )
    service_lane: jax.Array | int = number(
        2, 0, 5, "", "a MED with a lane on either side has four slots", whole=True
    )
    reserve_soc: Scalar = number(0.1, 0, 1, "", "charge that a MED keeps for its way home; chosen")


class ChargingParams(struct.PyTreeNode):
    """Requests, booking and docking."""

    request_soc: Scalar = number(0.4, 0, 1, "", "an EV with less charge requests a slot; chosen")
    stop_soc: Scalar = number(
        0.1,
        0,
        1,
        "",
        "an EV that would have less at the charger beyond the next exit takes that exit to charge; chosen",
    )
    wanted_soc: Scalar = number(
        0.0,
        0,
        1,
        "",
        "charge with which EVs want to reach their destination, by which forecasts tell who is in need; 0: just to "
        "reach it",
    )
    target_soc: Scalar = number(0.8, 0, 1, "", "an EV leaves its slot at this charge; chosen")
    reach_ahead_m: Scalar = number(
        400.0, 0, 200e3, "m", "how far ahead of an EV a MED may be booked; chosen"
    )
    reach_behind_m: Scalar = number(
        100.0, 0, 200e3, "m", "how far behind an EV a MED may be booked; chosen"
    )
    patience_s: Scalar = number(
        60.0,
        0.1,
        1e6,
        "s",
        "time after which a booking lapses if the EV has not docked; who would need longer does not book",
    )
    retry_s: Scalar = number(
        10.0, 0, 1e6, "s", "time from a lapsed booking to the EV's next request; chosen"
    )
    approach_speed: Scalar = number(
        8.0, 0.1, 50, "m/s", "highest speed relative to the MED at which an EV closes up; chosen"
    )
    slowest_share: Scalar = number(
        0.75,
        0.1,
        1,
        "",
        "an EV that falls back to its slot keeps at least this share of the service speed; chosen",
    )
    approach_rate: Scalar = number(
        0.35, 0.01, 10, "1/s", "relative speed per metre to go; chosen: slightly underdamped"
    )
    speed_rate: Scalar = number(
        1.0, 0.01, 20, "1/s", "acceleration per m/s of relative speed error; chosen"
    )
    platoon_headway: Scalar = number(
        0.3,
        0.01,
        10,
        "s",
        "time headway between a MED and the EVs booked on it; as in truck platooning tests",
    )
    platoon_min_gap: Scalar = number(
        2.0, 0.1, 20, "m", "standstill gap in a platoon; as `drivers.min_gap`"
    )
    dock_gap_m: Scalar = number(
        12.0,
        0.1,
        100,
        "m",
        "bumper to bumper; chosen: above the platoon's gap at 22 m/s, 8.6 m; if that gap is larger than the sum "
        "of this and `dock_tolerance_m`, nobody reaches the rear and front slots",
    )
    dock_tolerance_m: Scalar = number(
        0.3,
        0.001,
        10,
        "m",
        "charging starts within this distance of the slot; chosen: efficiency stays above 0.9",
    )
    dock_speed_tolerance: Scalar = number(
        0.5, 0.001, 10, "m/s", "charging starts within this of the MED's speed; chosen"
    )
    hold_tolerance_m: Scalar = number(
        0.6,
        0.001,
        10,
        "m",
        "charging stops beyond the larger of this and `dock_tolerance_m`; chosen: the coils' null is at 0.58 m",
    )
    depleted_blocks: jax.Array | int = number(
        0,
        0,
        1,
        "",
        "a depleted EV makes for the right shoulder (0) or stays in its lane (1); chosen",
        whole=True,
    )
    tow_s: Scalar = number(
        2100.0,
        0,
        1e6,
        "s",
        "time until a depleted EV that stands in a lane is towed; HCM 7, ex. 11-22, read second-hand: 34.6 min",
    )
    slot_power_w: Scalar = number(
        40e3,
        0,
        10e6,
        "W",
        "highest power drawn from the MED per charging slot; chosen between dynamic demonstrators (20 kW) and "
        "static heavy duty (120 kW)",
    )
    taper_soc: Scalar = number(
        0.8,
        0,
        1,
        "",
        "above this charge an EV takes less power, down to zero when full; usual for fast charging",
    )
    plug_power_w: Scalar = number(
        150e3,
        1.0,
        10e6,
        "W",
        "power of a plug at an exit; what EU Regulation 2023/1804 asks of a charging point on the core road network",
    )
    plug_target_soc: Scalar = number(
        0.8, 0, 0.99, "", "an EV leaves its plug at this charge, from where on charging is slow"
    )
    queue_seen_share: Scalar = number(
        0.0, 0, 1, "", "share of EV drivers who see the queues at all exits, as an app shows them"
    )


class LinkParams(struct.PyTreeNode):
    """Coils and circuit; `physics.tabulate_inductance` makes the table from the coil design."""

    inductance: InductanceTable = None  # type: ignore[assignment]  # `build_link` sets it
    panel_gap_m: Scalar = number(
        0.2, 0.05, 1, "m", "distance between docked panels, within the coils' table; SAE J2954 Z3"
    )
    misalignment_scale: Scalar = number(
        1.0,
        0,
        10,
        "",
        "share of the vehicles' misalignment that the coils see; 0: none, 1: all of it",
    )
    permeability: Scalar = number(
        1.0,
        1e-3,
        1e4,
        "",
        "relative permeability around the coils; multiplies their inductance; air",
    )
    max_current_a: Scalar = number(
        70.0,
        0,
        1e6,
        "A",
        "RMS limit of a MED's coil; a 50 kW, 85 kHz inverter on 800 V feeds 69 A (50 kW over 0.9 x 800 V); 42 A send "
        "40 kW at nominal alignment",
    )
    load_ohm: Scalar = number(10.0, 1e-3, 1e6, "ohm", "reference")
    med_resistance_ohm: Scalar = number(0.159, 1e-6, 10e3, "ohm", "reference")
    ev_resistance_ohm: Scalar = number(0.126, 1e-6, 10e3, "ohm", "reference")
    angular_frequency: Scalar = number(2.0 * math.pi * 85e3, 1, 1e9, "rad/s", "85 kHz, SAE J2954")


@dataclasses.dataclass(frozen=True)
class CoilDesign:
    """The coils of both sides; `build_link` tabulates their mutual inductance."""

    med_coil_radius_m: float = number(0.35, 0.01, 5, "m", "reference")
    ev_coil_radius_m: float = number(0.30, 0.01, 5, "m", "reference")
    med_coil_turns: int = number(10, 1, 1000, "", "reference")
    ev_coil_turns: int = number(10, 1, 1000, "", "reference")


def build_link(design: CoilDesign, params: LinkParams | None = None) -> LinkParams:
    """Builds the link of a coil design; works under `jax.vmap` over the design's numbers.

    Args:
      design: the coils.
      params: all other parameters of the link; None takes the defaults.
    """
    # Even where JAX's default float is wider; in the order of the fields.
    med_m, ev_m, med_turns, ev_turns = map(jax.numpy.float32, vars(design).values())
    table = tabulate_inductance(med_m, ev_m, primary_turns=med_turns, secondary_turns=ev_turns)
    return (params or LinkParams()).replace(inductance=table)


class BodyParams(struct.PyTreeNode):
    """Road load and drivetrain of an EV or a MED, eqs (7)-(8)."""

    mass_kg: Scalar = number(
        (1636.03, 15076.0), 1, 1e6, "kg", ("Nissan Leaf 30 kWh, fastsim", "reference: a 15 t truck")
    )
    drag_coefficient: Scalar = number(
        (0.315, 0.8), 1e-3, 10, "", ("source as for `mass_kg`", "source as for `mass_kg`")
    )
    frontal_area_m2: Scalar = number(
        (2.755, 10.0), 0.01, 100, "m2", ("source as for `mass_kg`", "source as for `mass_kg`")
    )
    rolling_resistance: Scalar = number(
        (0.008, 0.0092), 1e-4, 1, "", ("source as for `mass_kg`", "source as for `mass_kg`")
    )
    rotational_inertia_factor: Scalar = number(
        (1.01765, 1.01765), 1, 10, "", ("source as for `mass_kg`", "as for the EV")
    )
    drivetrain_efficiency: Scalar = number(
        (0.90, 0.90), 0.01, 1, "", ("reference, steady speed columns", "as for the EV")
    )
    regeneration_efficiency: Scalar = number((0.6, 0.6), 0, 1, "", ("chosen", "chosen"))
    auxiliary_w: Scalar = number(
        (250.0, 1000.0), 0, 1e6, "W", ("reference, steady speed columns", "chosen")
    )
    pack_j: Scalar = number(
        (30.0 * JOULES_PER_KWH, 400.0 * JOULES_PER_KWH),
        3.6e3,
        3.6e12,
        "J",
        ("true capacity: 30 kWh", "true capacity: 400 kWh"),
    )


NISSAN_LEAF, TRUCK = (
    BodyParams(
        **{name: declared.default[body] for name, declared in numbers_of(BodyParams).items()}
    )
    for body in range(2)
)
