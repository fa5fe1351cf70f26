"""The pytrees that a step carries. Shapes are of one environment; `jax.vmap` adds the batch axis."""

from __future__ import annotations

import warnings

import jax
import jax.numpy as jnp
from flax import struct

from medjax.world.kinds import GAS_KINDS, KINDS
from medjax.world.params import EnvConfig

# Stages of a MED's life cycle.
STATUS_NAMES = (
    *("at the depot", "waiting at its ramp", "merging", "in service", "gone"),
    "making for its exit",
)
AT_DEPOT, QUEUED, MERGING, IN_SERVICE, RETIRED, LEAVING = range(len(STATUS_NAMES))

NOT_BOOKED = -1


class Vehicles(struct.PyTreeNode):
    """Vehicles by slot (`EnvConfig.med_slots` and so on). N = num_vehicles."""

    x: jax.Array  # (N,) m, front bumper
    speed: jax.Array  # (N,) m/s
    lane: jax.Array  # (N,) int32, 0 leftmost; num_lanes is an acceleration lane
    active: jax.Array  # (N,) bool, on the road
    kind: jax.Array  # (N,) int32 in `medjax.world.kinds.KINDS`
    lateral_offset: jax.Array  # (N,) m from the lane's centre, positive to the right
    lateral_speed: jax.Array  # (N,) m/s
    desired_speed: jax.Array  # (N,) m/s
    acceleration_noise: jax.Array  # (N,) m/s^2
    wander: jax.Array  # (N,) m, lateral offset the driver steers to
    headway: jax.Array  # (N,) s, current time headway; a short one relaxes to the desired one
    # (N,) m/s^2, upper limit of acceleration, to let a vehicle in from the left or to change there; inf: no limit.
    courtesy_left: jax.Array
    courtesy_right: jax.Array  # the same to the right
    recovery_s: jax.Array  # (N,) s, until the next discretionary lane change may be considered
    destination: jax.Array  # (N,) m, the exit where it leaves the road, or the road's end
    road_order: jax.Array  # (N,) int32, slots from rear to front across all lanes, of the last tick


class EVs(struct.PyTreeNode):
    """EV state beyond `Vehicles`. E = num_evs."""

    energy_j: jax.Array  # (E,)
    rest_j: jax.Array  # (E,) rounding remainder of energy_j
    med: jax.Array  # (E,) int32, MED it is booked on, or NOT_BOOKED
    charging_slot: jax.Array  # (E,) int32, index in CHARGING_SLOTS of that MED's, or NOT_BOOKED
    stops: jax.Array  # (E,) bool, heads for an exit to charge there
    is_charging: jax.Array  # (E,) bool
    waiting_s: (
        jax.Array
    )  # (E,) booked but not charging for so long, since booking or its last charge
    retry_in_s: jax.Array  # (E,) until it may request a MED
    standing_s: jax.Array  # (E,) has stood depleted for so long
    served: jax.Array  # (E,) bool, has charged at least once
    complies: jax.Array  # (E,) bool, its driver slows down to save charge
    is_depleted: jax.Array  # (E,) bool, ran out, on the road or off it

    @property
    def panel(self) -> jax.Array:
        """Former name of `charging_slot`, for one more version."""
        text = "EVs.panel is now EVs.charging_slot; the old name goes with the next version"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return self.charging_slot


class MEDs(struct.PyTreeNode):
    """MED state beyond `Vehicles`. M = num_meds."""

    energy_j: jax.Array  # (M,)
    rest_j: jax.Array  # (M,) rounding remainder of energy_j
    status: jax.Array  # (M,) int32, index into STATUS_NAMES
    depot: jax.Array  # (M,) int32, where it waits, or returns after leaving the road
    ramp: jax.Array  # (M,) int32, ramp that it was sent to
    ready_in_s: jax.Array  # (M,) until a retired MED is back at its depot
    service_speed: jax.Array  # (M,) m/s, speed in service
    service_lane: jax.Array  # (M,) int32, lane in which it serves or will serve
    accepts: jax.Array  # (M,) bool, accepts new bookings


class EpisodeStats(struct.PyTreeNode):
    """Sums over time from which metrics and rewards are computed; all float32."""

    entered: jax.Array  # (num_kinds,) vehicles of each kind, including those on the road at reset
    left: jax.Array  # (num_kinds,) at an exit or the end of the road, except depleted EVs
    missed_exits: jax.Array  # () vehicles that could not reach their exit
    charging_stops: jax.Array  # () EVs that left to charge at an exit
    depleted: jax.Array  # () EVs that ran out
    ev_seconds: jax.Array  # () integral of the number of EVs on the road
    ev_distance_m: jax.Array  # ()
    soc_seconds: jax.Array  # () integral of the sum of the EVs' state of charge
    mean_soc_s: jax.Array  # () integral of the EVs' mean state of charge, as of each round's end
    mean_speed_m: jax.Array  # () integral of their mean speed in each round
    exit_soc: jax.Array  # () sum of the state of charge of the EVs that left
    low_exits: jax.Array  # () EVs that left for a charger, or by the road's end below request_soc
    ev_delay_s: jax.Array  # () delay of EVs relative to their own desired speeds
    gas_seconds: jax.Array  # (num_gas_kinds,) for each of `medjax.world.kinds.GAS_KINDS`
    gas_distance_m: jax.Array  # (num_gas_kinds,)
    gas_delay_s: jax.Array  # () delay of gas vehicles relative to their own desired speeds
    med_seconds: jax.Array  # () integral of the number of MEDs from dispatch until off the road
    vehicle_ticks: jax.Array  # () vehicles on the road, summed over ticks
    energy_sent_j: jax.Array  # () out of MEDs through their slots
    energy_received_j: jax.Array  # () into EVs
    ev_driving_j: jax.Array  # () energy that EVs used to drive
    ev_cruising_j: jax.Array  # () energy for the same distance at their own desired speeds
    med_driving_j: jax.Array  # () energy that MEDs used to drive
    evs_served: jax.Array  # () EVs that began to charge for the first time
    meds_dispatched: jax.Array  # ()
    depot_energy_j: jax.Array  # () into MEDs at their depots
    queue_seconds: jax.Array  # () integral of the number of vehicles waiting to enter
    lane_changes: jax.Array  # ()
    collisions: jax.Array  # () vehicles that overlap their leader, summed over ticks
    invalid_actions: jax.Array  # () actions out of range or masked
    # Actions of MEDs as agents (`medjax.env.agents`): integrals over MEDs in service at a decision.
    told_seconds: jax.Array  # ()
    told_speed_m: jax.Array  # () of the ordered service speed
    refusing_seconds: jax.Array  # () of those that refuse new bookings
    left_early: jax.Array  # () MEDs that chose to leave before they had to

    @classmethod
    def zeros(cls, zero: jax.Array | int = 0) -> EpisodeStats:
        """An empty tally.

        Args:
          zero: () integer 0. Derive it from the state where the tally is a loop carry: if the carry starts as a
            constant, `jax.vmap` traces the loop again once the carry becomes batched.
        """
        number = jnp.asarray(zero, jnp.float32)
        scalars = dict.fromkeys(cls.__dataclass_fields__, number)
        kinds = dict.fromkeys(("entered", "left"), jnp.full((len(KINDS),), number))
        gas = jnp.full((len(GAS_KINDS),), number)
        return cls(**scalars | kinds | {"gas_seconds": gas, "gas_distance_m": gas})

    def __add__(self, other: EpisodeStats) -> EpisodeStats:
        return jax.tree.map(jnp.add, self, other)


def count_kinds(flags: jax.Array, kind: jax.Array, config: EnvConfig) -> jax.Array:
    """Number of flagged vehicles of each kind, `(num_kinds,)` float32, from flags and kinds `(N,)`."""
    counts = []
    for index, row in enumerate(KINDS):
        slots = config.class_slots[row.slots]  # the only slots that hold this kind
        counts.append(jnp.sum(flags[slots] & (kind[slots] == index), dtype=jnp.float32))
    return jnp.stack(counts)


class EnvState(struct.PyTreeNode):
    """State of one environment between two decisions."""

    vehicles: Vehicles
    evs: EVs
    meds: MEDs
    queue: jax.Array  # (num_entries,) int32, vehicles waiting at each entry
    entered_here: jax.Array  # (num_entries,) int32, vehicles other than MEDs that entered there
    arrivals: jax.Array  # (2,) uint32, seed of the arrivals (`medjax.traffic.arrivals`)
    cooldown_s: jax.Array  # () until the next dispatch is allowed
    time: jax.Array  # () int32, decisions taken
    tally: EpisodeStats  # since reset
