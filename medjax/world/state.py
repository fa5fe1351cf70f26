"""The pytrees that a step carries. Shapes are for one environment; `jax.vmap` adds the batch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from medjax.world.kinds import GAS_KINDS, KINDS
from medjax.world.params import EnvConfig

# Where a MED is in its day.
STATUS_NAMES = (
    *("at the depot", "waiting at its ramp", "merging", "in service", "gone"),
    "making for its exit",
)
AT_DEPOT, QUEUED, MERGING, IN_SERVICE, RETIRED, LEAVING = range(len(STATUS_NAMES))

NOT_BOOKED = -1


class Vehicles(struct.PyTreeNode):
    """Everything on the road, by slot (`EnvConfig.med_slots` and so on). N = num_vehicles."""

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
    headway: jax.Array  # (N,) s, that a driver keeps now: a short one grows back
    # (N,) m/s^2 at most, for one that comes from the left, or to go there; else inf. And the same to the right.
    courtesy_left: jax.Array
    courtesy_right: jax.Array
    recovery_s: jax.Array  # (N,) s, until a change that is only an advantage is thought of again
    destination: jax.Array  # (N,) m, the exit where it leaves the road, or the road's end
    road_order: (
        jax.Array
    )  # (N,) int32, slots from rear to front whatever the lane, of the last tick


class EVs(struct.PyTreeNode):
    """What an EV has beyond its vehicle. E = num_evs."""

    energy_j: jax.Array  # (E,)
    rest_j: jax.Array  # (E,) what rounding left out of energy_j
    med: jax.Array  # (E,) int32, MED it is booked on, or NOT_BOOKED
    panel: jax.Array  # (E,) int32, slot of that MED, or NOT_BOOKED
    stops: jax.Array  # (E,) bool, makes for its exit to charge there
    is_charging: jax.Array  # (E,) bool
    timer_s: jax.Array  # (E,) since booking or last charge; depleted: stood; else until it may ask
    served: jax.Array  # (E,) bool, has charged at least once
    complies: jax.Array  # (E,) bool, its driver slows down to save charge
    is_depleted: jax.Array  # (E,) bool, ran out, on the road or off it


class MEDs(struct.PyTreeNode):
    """What a MED has beyond its vehicle. M = num_meds."""

    energy_j: jax.Array  # (M,)
    rest_j: jax.Array  # (M,) what rounding left out of energy_j
    status: jax.Array  # (M,) int32, a place in STATUS_NAMES
    depot: jax.Array  # (M,) int32, where it is, or goes once it has left the road
    ramp: jax.Array  # (M,) int32, where it was sent
    ready_in_s: jax.Array  # (M,) until a retired MED is at the depot again
    service_speed: jax.Array  # (M,) m/s, that it drives in service
    service_lane: jax.Array  # (M,) int32, that it serves in, or makes for
    accepts: jax.Array  # (M,) bool, takes EVs that ask


class Tally(struct.PyTreeNode):
    """Sums over time of what the metrics and the rewards are made of; all float32."""

    entered: jax.Array  # (num_kinds,) vehicles of each kind, those on the road at reset included
    left: jax.Array  # (num_kinds,) at an exit or the end of the road, not those that ran out before
    missed_exits: jax.Array  # () vehicles that could not get to their exit
    charging_stops: jax.Array  # () EVs that left to charge at an exit
    depleted: jax.Array  # () EVs that ran out
    ev_seconds: jax.Array  # () integral of the number of EVs on the road
    ev_distance_m: jax.Array  # ()
    soc_seconds: jax.Array  # () integral of the sum of the EVs' state of charge
    mean_soc_s: jax.Array  # () integral of the EVs' mean state of charge, as of each round's end
    mean_speed_m: jax.Array  # () integral of their mean speed in each round
    exit_soc: jax.Array  # () sum of the state of charge of the EVs that left
    low_exits: jax.Array  # () EVs that left for a charger, or by the end with less charge than they ask for a slot with
    ev_delay_s: jax.Array  # () what EVs lost against their own desired speeds
    gas_seconds: jax.Array  # (num_gas_kinds,) of each of `medjax.world.kinds.GAS_KINDS`
    gas_distance_m: jax.Array  # (num_gas_kinds,)
    gas_delay_s: jax.Array  # () what gas vehicles lost against their own desired speeds
    med_seconds: jax.Array  # () integral of the number of MEDs sent and not off the road again
    vehicle_ticks: jax.Array  # () vehicles on the road, summed over ticks
    energy_sent_j: jax.Array  # () out of MEDs through their slots
    energy_received_j: jax.Array  # () into EVs
    ev_driving_j: jax.Array  # () what driving took from EVs
    ev_cruising_j: jax.Array  # () what the same way takes at their own desired speeds
    med_driving_j: jax.Array  # () what driving took from MEDs
    evs_served: jax.Array  # () EVs that began to charge for the first time
    meds_dispatched: jax.Array  # ()
    depot_energy_j: jax.Array  # () into MEDs at their depots
    queue_seconds: jax.Array  # () integral of vehicles waiting to enter
    lane_changes: jax.Array  # ()
    collisions: jax.Array  # () vehicles found overlapping their leader, summed over ticks
    invalid_actions: jax.Array  # () actions out of range, or masked
    # What agents were told, if MEDs are any (`medjax.env.agents`): integrals over MEDs in service at a decision.
    told_seconds: jax.Array  # ()
    told_speed_m: jax.Array  # () of the speed
    refusing_seconds: jax.Array  # () in which they take nobody
    left_early: jax.Array  # () that made for an exit on their own

    @classmethod
    def zeros(cls, zero: jax.Array | int = 0) -> Tally:
        """Nothing has happened.

        Args:
          zero: () integer 0. A sum that begins as a constant has JAX's `vmap` work the ticks out again once it becomes
            each environment's own; a zero made of an environment's state begins as its own.
        """
        number = jnp.asarray(zero, jnp.float32)
        scalars = dict.fromkeys(cls.__dataclass_fields__, number)
        kinds = dict.fromkeys(("entered", "left"), jnp.full((len(KINDS),), number))
        gas = jnp.full((len(GAS_KINDS),), number)
        return cls(**scalars | kinds | {"gas_seconds": gas, "gas_distance_m": gas})

    def __add__(self, other: Tally) -> Tally:
        return jax.tree.map(jnp.add, self, other)


def count_kinds(flags: jax.Array, kind: jax.Array, config: EnvConfig) -> jax.Array:
    """How many vehicles of each kind have a flag, `(num_kinds,)` float32 from `(N,)` each."""
    counts = []
    for index, row in enumerate(KINDS):
        slots = config.class_slots[row.slots]  # a kind is nowhere else
        counts.append(jnp.sum(flags[slots] & (kind[slots] == index), dtype=jnp.float32))
    return jnp.stack(counts)


class EnvState(struct.PyTreeNode):
    """One environment between two decisions."""

    vehicles: Vehicles
    evs: EVs
    meds: MEDs
    queue: jax.Array  # (num_entries,) int32, vehicles waiting at each entry
    entered_here: jax.Array  # (num_entries,) int32, vehicles that came by themselves at each entry
    arrivals: jax.Array  # (2,) uint32, seed of who arrives, and when (`medjax.traffic.arrivals`)
    cooldown_s: jax.Array  # () until the next dispatch is allowed
    time: jax.Array  # () int32, decisions taken
    tally: Tally  # since reset
