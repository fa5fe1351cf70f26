"""Static sizes (EnvConfig) and traced parameters (EnvParams) of an environment.

EnvConfig holds everything that changes the compiled program. Every other number is a leaf of EnvParams, so that
`jax.vmap` can run over demands, reward weights, batteries or coil designs in one program. EnvConfig checks itself;
`medjax.make` checks both on the host, as `medjax.world.checks.validate` does.

Each number is declared once, by `number`: here, in `demand_params`, `traffic_params` or `charging_params`. The
declarations define the checks, the names that `medjax.make` takes, the preset `paper`, and the tables of
docs/parameters.md, which `python -m docs.parameters` writes.

Every `(num_kinds,)` leaf is in the order of `medjax.world.kinds.KINDS`.
"""

from __future__ import annotations

import dataclasses
from typing import get_type_hints

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike

from medjax.errors import InputError, former_names, shown
from medjax.world.charging_params import (
    NISSAN_LEAF,
    TRUCK,
    BodyParams,
    ChargingParams,
    CoilDesign,
    FleetParams,
    LinkParams,
)
from medjax.world.demand_params import DemandParams
from medjax.world.incident_params import IncidentParams
from medjax.world.kinds import CLASSES
from medjax.world.numbers import number, numbers_of, read_number
from medjax.world.traffic_params import (
    DriverParams,
    LaneChangeParams,
    MotionParams,
    RoadParams,
    Scalar,
)
from medjax.world.weights import WEIGHTS, MarketParams

CHARGING_SLOTS = ("left", "right", "rear", "front")
LEFT, RIGHT, REAR, FRONT = range(4)
__getattr__ = former_names(__name__, PANELS="CHARGING_SLOTS")


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """Sizes and time steps, which fix array shapes and loops; hashable, one compiled program per config.

    Vehicle slots are ordered MEDs, EVs, gas vehicles, so each class is a slice.

    Raises:
      InputError: names the field, its value and what is allowed.
    """

    num_meds: int = number(15, 1, 64, text="MED slots; the most that the paper sends", whole=True)
    num_evs: int = number(
        40,
        1,
        4096,
        text="EV slots; chosen: 2.8 times the number at 30 m/s, because EVs that charge stay longer",
        whole=True,
    )
    num_gas: int = number(
        153, 0, 4096, text="gas vehicle slots; chosen: 1.5 times the number at 30 m/s", whole=True
    )
    num_lanes: int = number(4, 1, 6, text="main lanes; paper", whole=True)
    num_ramps: int = number(4, 0, 8, text="on-ramps; paper", whole=True)
    num_exits: int = number(0, 0, 8, text="off-ramps; paper: none", whole=True)
    num_depots: int = number(
        1,
        1,
        8,
        text="depots of MEDs, which share the ramps as evenly as possible; paper: one",
        whole=True,
    )
    num_plugs: int = number(
        0,
        0,
        64,
        text="fast-charging plugs at each exit; 0: what EVs do at a charger is not simulated; paper: none",
        whole=True,
    )
    num_surges: int = number(
        0,
        0,
        64,
        text="surges of demand in an episode, each at a drawn ramp and time that dispatchers do not know; paper: none",
        whole=True,
    )
    has_detectors: int = number(
        0,
        0,
        1,
        text="1: detectors count the vehicles at each entry, and forecasts and observations go by them; 0: by the "
        "demand's true rates; paper: none",
        whole=True,
    )
    num_incidents: int = number(
        0,
        0,
        8,
        text="incidents in an episode, each of which blocks a lane; paper: none",
        whole=True,
    )
    num_periods: int = number(1, 1, 1000, text="rows of `demand.profile`; paper: one", whole=True)
    tick_s: float = number(
        0.25, 0.02, 0.5, "s", "chosen: half the stability limit of the ballistic update"
    )
    ticks_per_round: int = number(
        4,
        1,
        100,
        text="ticks per round, in which an entry admits at most one vehicle; chosen: one round per second",
        whole=True,
    )
    rounds_per_decision: int = number(
        1, 1, 100, text="rounds of entries, bookings, trip plans and their ticks", whole=True
    )

    def __post_init__(self) -> None:
        """Checks the values and stores them as Python numbers."""
        for name, declared in numbers_of(self).items():
            value = getattr(self, name)
            read = read_number(name, value, declared)
            object.__setattr__(self, name, read.item() if declared.whole else float(value))
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
        """Action 0 sends no MED, action r sends one from ramp r - 1."""
        return 1 + self.num_ramps

    @property
    def ramp_depots(self) -> tuple[int, ...]:
        """The depot of each ramp; adjacent ramps share one, and the split is as even as possible."""
        return tuple(ramp * self.num_depots // self.num_ramps for ramp in range(self.num_ramps))

    @property
    def decision_s(self) -> float:
        """Seconds between two decisions."""
        return self.tick_s * self.ticks_per_decision

    @property
    def ticks_per_decision(self) -> int:
        """Ticks between two decisions."""
        return self.ticks_per_round * self.rounds_per_decision

    @property
    def round_s(self) -> float:
        """Seconds between two rounds of entries."""
        return self.tick_s * self.ticks_per_round

    @property
    def lane_change_groups(self) -> int:
        """Number of groups that consider lane changes in turn, so that each looks both ways once a second."""
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
        """Slots of all vehicles except MEDs: EVs, then gas vehicles."""
        return slice(self.num_meds, self.num_vehicles)

    def by_slot(self, meds: ArrayLike, evs: ArrayLike, gas: ArrayLike) -> jax.Array:
        """Joins values of each class, `(C,)` or a scalar for all its slots, into one array `(num_vehicles,)`."""
        parts = ((meds, self.num_meds), (evs, self.num_evs), (gas, self.num_gas))
        return jnp.concatenate([jnp.broadcast_to(part, (size,)) for part, size in parts])


class EnvParams(struct.PyTreeNode):
    """Every parameter of the world; a pytree whose leaves may be traced or batched."""

    road: RoadParams = struct.field(default_factory=RoadParams)
    demand: DemandParams = struct.field(default_factory=DemandParams)
    drivers: DriverParams = struct.field(default_factory=DriverParams)
    motion: MotionParams = struct.field(default_factory=MotionParams)
    lane_change: LaneChangeParams = struct.field(default_factory=LaneChangeParams)
    fleet: FleetParams = struct.field(default_factory=FleetParams)
    charging: ChargingParams = struct.field(default_factory=ChargingParams)
    link: LinkParams = struct.field(default_factory=LinkParams)
    market: MarketParams = struct.field(default_factory=MarketParams)
    incidents: IncidentParams = struct.field(default_factory=IncidentParams)
    ev: BodyParams = NISSAN_LEAF
    med: BodyParams = TRUCK
    battery_scale: Scalar = number(
        30.0, 1e-3, 1e6, "", "divides every battery capacity, but no power"
    )
    reward_weights: dict[str, Scalar] = struct.field(
        default_factory=lambda: {term: weight.default for term, weight in WEIGHTS.items()}
    )  # by reward term
    episode_decisions: Scalar = number(
        600,
        1,
        10_000_000,
        "",
        "decisions until truncation, ten minutes; the paper gives none",
        whole=True,
    )

    @property
    def ev_capacity_j(self) -> Scalar:
        """Energy of a full EV, J."""
        return _quotient(self.ev.pack_j, self.battery_scale)

    @property
    def med_capacity_j(self) -> Scalar:
        """Energy of a full MED, J."""
        return _quotient(self.med.pack_j, self.battery_scale)


def _quotient(numerator: Scalar, denominator: Scalar) -> Scalar:
    """Numerator / denominator behind a barrier, or XLA would rewrite x / (a / b) as x b / a in some programs only."""
    return jax.lax.optimization_barrier(numerator / denominator)


# `medjax.traffic.neighbours` lays all lanes, the acceleration lane and a lane for empty slots out in one line.
MOST_PLACES = 2**16


def validate_config(config: EnvConfig) -> None:
    """Raises InputError unless config is an EnvConfig, which checked its own values when built."""
    if not isinstance(config, EnvConfig):
        raise InputError(f"config = {shown(config)}: allowed an EnvConfig")


def _check_places(config: EnvConfig) -> None:
    most = MOST_PLACES // (config.num_lanes + 2) - 2
    if config.num_vehicles > most:
        raise InputError(
            f"num_meds + num_evs + num_gas = {config.num_vehicles}: allowed at most {most} with "
            f"num_lanes = {config.num_lanes}"
        )
    if config.num_plugs and not config.num_exits:
        raise InputError(f"num_plugs = {config.num_plugs}: allowed 0 with num_exits = 0")
    if config.num_surges and not config.num_ramps:
        raise InputError(f"num_surges = {config.num_surges}: allowed 0 with num_ramps = 0")
    if config.num_incidents and not config.num_gas:
        raise InputError(f"num_incidents = {config.num_incidents}: allowed 0 with num_gas = 0")
    depots = max(config.num_ramps, 1)
    if config.num_depots > depots:
        raise InputError(
            f"num_depots = {config.num_depots}: allowed at most one per ramp, {depots} with "
            f"num_ramps = {config.num_ramps}"
        )


SIZES = numbers_of(EnvConfig)
COILS = numbers_of(CoilDesign)
OTHERS = numbers_of(EnvParams)
GROUPS = {
    name: numbers_of(kind)
    for name, kind in get_type_hints(EnvParams).items()
    if dataclasses.is_dataclass(kind)
}
"""Declarations of all numbers by group and name; OTHERS holds those that belong to no group."""
