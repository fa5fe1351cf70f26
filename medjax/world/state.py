"""The pytrees that a step carries. Shapes are of one environment; `jax.vmap` adds the batch axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array
from jaxtyping import Bool, Float32, Int32, UInt32

from medjax.errors import renamed
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
    """Vehicles by slot (`EnvConfig.med_slots` and so on)."""

    x: Float32[Array, "num_vehicles"]  # m, front bumper
    speed: Float32[Array, "num_vehicles"]  # m/s
    lane: Int32[Array, "num_vehicles"]  # 0 leftmost; num_lanes is an acceleration lane
    active: Bool[Array, "num_vehicles"]  # on the road
    kind: Int32[Array, "num_vehicles"]  # in `medjax.world.kinds.KINDS`
    lateral_offset: Float32[Array, "num_vehicles"]  # m right of the lane's centre
    lateral_speed: Float32[Array, "num_vehicles"]  # m/s
    desired_speed: Float32[Array, "num_vehicles"]  # m/s
    acceleration_noise: Float32[Array, "num_vehicles"]  # m/s^2
    wander: Float32[Array, "num_vehicles"]  # m, lateral offset the driver steers to
    headway: Float32[Array, "num_vehicles"]  # s, now; a short one relaxes to the desired one
    # m/s^2, upper limit of acceleration, to let a vehicle in from the left or to change there; inf: no limit.
    courtesy_left: Float32[Array, "num_vehicles"]
    courtesy_right: Float32[Array, "num_vehicles"]  # the same to the right
    recovery_s: Float32[Array, "num_vehicles"]  # s, until it may change lanes at will
    destination: Float32[Array, "num_vehicles"]  # m, its exit, or the road's end
    # Slots from rear to front in the last tick; as at reset where no CPU steps it.
    road_order: Int32[Array, "num_vehicles"]


class EVs(struct.PyTreeNode):
    """EV state beyond `Vehicles`."""

    energy_j: Float32[Array, "num_evs"]
    rest_j: Float32[Array, "num_evs"]  # rounding remainder of energy_j
    med: Int32[Array, "num_evs"]  # MED it is booked on, or NOT_BOOKED
    charging_slot: Int32[Array, "num_evs"]  # in CHARGING_SLOTS, or NOT_BOOKED
    stops: Bool[Array, "num_evs"]  # heads for an exit to charge there
    is_charging: Bool[Array, "num_evs"]
    waiting_s: Float32[Array, "num_evs"]  # booked, but not charging for so long
    retry_in_s: Float32[Array, "num_evs"]  # until it may request a MED
    standing_s: Float32[Array, "num_evs"]  # has stood depleted for so long
    served: Bool[Array, "num_evs"]  # has charged at least once
    complies: Bool[Array, "num_evs"]  # its driver slows down to save charge
    sees_queues: Bool[Array, "num_evs"] | None  # its driver sees those at exits; None without plugs
    is_depleted: Bool[Array, "num_evs"]  # ran out, on the road or off it

    @property
    def panel(self) -> jax.Array:
        """Former name of `charging_slot`, for one more version."""
        return renamed("EVs.panel", "charging_slot", self.charging_slot)

    @property
    def timer_s(self) -> jax.Array:
        """Former field of three meanings, for one more version."""
        free_or_waiting = jnp.where(self.med == NOT_BOOKED, self.retry_in_s, self.waiting_s)
        timer = jnp.where(self.is_depleted, self.standing_s, free_or_waiting)
        return renamed("EVs.timer_s", "waiting_s, retry_in_s or standing_s", timer)


class MEDs(struct.PyTreeNode):
    """MED state beyond `Vehicles`."""

    energy_j: Float32[Array, "num_meds"]
    rest_j: Float32[Array, "num_meds"]  # rounding remainder of energy_j
    status: Int32[Array, "num_meds"]  # index into STATUS_NAMES
    depot: Int32[Array, "num_meds"]  # where it waits, or returns after leaving the road
    ramp: Int32[Array, "num_meds"]  # ramp that it was sent to
    ready_in_s: Float32[Array, "num_meds"]  # until a retired MED is back at its depot
    service_speed: Float32[Array, "num_meds"]  # m/s, speed in service
    service_lane: Int32[Array, "num_meds"]  # lane in which it serves or will serve
    accepts: Bool[Array, "num_meds"]  # accepts new bookings


class EpisodeStats(struct.PyTreeNode):
    """Sums over time from which metrics and rewards are computed."""

    entered: Float32[Array, "num_kinds"]  # vehicles, those at reset included
    left: Float32[Array, "num_kinds"]  # at an exit or the end of the road, except depleted EVs
    missed_exits: Float32[Array, ""]  # vehicles that could not reach their exit
    charging_stops: Float32[
        Array, ""
    ]  # EVs that left to charge, at an exit or, past the last one, at the road's end
    plug_stops: Float32[Array, ""]  # of these, EVs that took a plug (`EnvConfig.num_plugs`)
    plug_wait_s: Float32[Array, ""]  # their waits for it
    plug_charging_s: Float32[Array, ""]  # and the times that they charge there
    plug_energy_j: Float32[Array, ""]  # and the energy that they take
    depleted: Float32[Array, ""]  # EVs that ran out
    ev_seconds: Float32[Array, ""]  # integral of the number of EVs on the road
    ev_distance_m: Float32[Array, ""]
    soc_seconds: Float32[Array, ""]  # integral of the sum of the EVs' state of charge
    mean_soc_s: Float32[Array, ""]  # integral of the mean at each round's end
    mean_speed_m: Float32[Array, ""]  # integral of their mean speed in each round
    exit_soc: Float32[Array, ""]  # sum of the state of charge of the EVs that left
    low_exits: Float32[Array, ""]  # left for a charger, or below request_soc
    ev_delay_s: Float32[Array, ""]  # delay of EVs relative to their own desired speeds
    gas_seconds: Float32[Array, "num_gas_kinds"]  # by `medjax.world.kinds.GAS_KINDS`
    gas_distance_m: Float32[Array, "num_gas_kinds"]
    gas_delay_s: Float32[Array, ""]  # likewise of gas vehicles
    med_seconds: Float32[Array, ""]  # integral of MEDs between dispatch and exit
    vehicle_ticks: Float32[Array, ""]  # vehicles on the road, summed over ticks
    energy_sent_j: Float32[Array, ""]  # out of MEDs through their slots
    energy_received_j: Float32[Array, ""]  # into EVs
    ev_driving_j: Float32[Array, ""]  # energy that EVs used to drive
    ev_cruising_j: Float32[Array, ""]  # energy for the same distance at their own desired speeds
    med_driving_j: Float32[Array, ""]  # energy that MEDs used to drive
    evs_served: Float32[Array, ""]  # EVs that began to charge for the first time
    meds_dispatched: Float32[Array, ""]
    depot_energy_j: Float32[Array, ""]  # into MEDs at their depots
    queue_seconds: Float32[Array, ""]  # integral of the number of vehicles waiting to enter
    lane_changes: Float32[Array, ""]
    collisions: Float32[Array, ""]  # vehicles that overlap their leader, summed over ticks
    invalid_actions: Float32[Array, ""]  # actions out of range or masked
    # Actions of MEDs as agents (`medjax.env.agents`): integrals over MEDs in service at a decision.
    told_seconds: Float32[Array, ""]
    told_speed_m: Float32[Array, ""]  # of the ordered service speed
    refusing_seconds: Float32[Array, ""]  # of those that refuse new bookings
    left_early: Float32[Array, ""]  # MEDs that chose to leave before they had to

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
    queue: Int32[Array, "num_entries"]  # vehicles waiting at each entry
    entered_here: Int32[Array, "num_entries"]  # vehicles other than MEDs that entered there
    # vehicles/s, smoothed counts of the detectors at each entry; None without detectors.
    detected_per_s: Float32[Array, "num_entries"] | None
    arrivals: UInt32[Array, "2"]  # seed of the arrivals (`medjax.traffic.arrivals`)
    # Uniform draws for the time and the ramp of each surge (`medjax.traffic.demand.surge_starts`); None without surges.
    surges: Float32[Array, "num_surges 2"] | None
    # s, until each plug is free; 0: free. None without plugs, since an array of size 0 cannot be reshaped to (-1, 0).
    plugs_free_in_s: Float32[Array, "num_exits num_plugs"] | None
    # s, for which each gas vehicle that broke down will stand yet; 0: it drives. None without incidents.
    stands_for_s: Float32[Array, "num_gas"] | None
    cooldown_s: Float32[Array, ""]  # until the next dispatch is allowed
    time: Int32[Array, ""]  # decisions taken
    stats: EpisodeStats  # since reset

    @property
    def tally(self) -> EpisodeStats:
        """Former name of `stats`, for one more version."""
        return renamed("EnvState.tally", "stats", self.stats)
