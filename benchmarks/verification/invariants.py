"""Invariants that must hold whatever happens on the road, checked from states alone.

The checks do not rely on the simulator's neighbour search, energy formulas or tallies. They sort vehicles on their own,
derive energies from work and kinetic energy (`flows`), and compute sums (`ledger`) from the states that a probe reports
after every tick (`ChargingEnv.with_probe`).

Every check returns flags by invariant (`INVARIANTS`) and by what it looked at. True marks a violation. `count`
reduces them to one number per invariant, so that `jax.vmap` can check thousands of environments fast.
"""

from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.verification.boxes import lanes_covered, overlapping_vehicles
from benchmarks.verification.ledger import ROUNDING_M, Ledger, at_exit, entry_ledger, tick_ledger
from medjax.numerics.gathers import read
from medjax.traffic.demand import entries
from medjax.world.params import CHARGING_SLOTS, EnvConfig, EnvParams
from medjax.world.state import (
    AT_DEPOT,
    IN_SERVICE,
    LEAVING,
    MERGING,
    NOT_BOOKED,
    QUEUED,
    RETIRED,
    EnvState,
    Vehicles,
)

INVARIANTS = {
    "overlap": "bumper gaps within a lane are not negative",
    "boxes": "no two bodies overlap, whatever lanes they count to",
    "passed": "nobody drives through another one in its lane",
    "speed": "nobody drives backwards",
    "motion": "a vehicle moves no farther than its speeds allow, changes one lane at most, and stays the same",
    "road": "vehicles are on a lane, before the end of the road or of their acceleration lane",
    "vehicles": "vehicles enter by entries, leave by exits, at the road's end or without energy; none is lost",
    "standing": "no vehicle that could drive stands on a main lane with open road ahead",
    "bookings": "one EV per slot, one slot per EV, EV and MED on the road; a booking stays until it ends",
    "soc": "states of charge are in [0, 1]",
    "energy": "what batteries give, get and spend balances",
    "finite": "every number is finite",
    "reward": "the reward is the sum of its terms, and each term has the value that the states give",
    "tally": "the simulator counts what happened",
}
Flags = dict[str, dict[str, jax.Array]]  # by invariant, by what was looked at; True: violated

# A vehicle below this speed, with this much open road ahead, has no reason to stand for this long.
STANDS_M_PER_S, OPEN_M, STANDS_S = 0.5, 60.0, 5.0
# Rounding of positions and speeds within a tick is far below `ROUNDING_M` and this relative bound.
ROUNDING = 1e-5
# Bound of a unit in the last place, relative. At 100 km that unit is 8 mm, more than `ROUNDING_M`.
POSITION_RTOL = 2.0**-23


def count(*checks: Flags) -> jax.Array:
    """Violations of each of INVARIANTS in the checks, in their order, (K,) int32."""

    def total(name: str) -> jax.Array:
        flags = [flag for check in checks for flag in check.get(name, {}).values()]
        return sum((jnp.sum(flag, dtype=jnp.int32) for flag in flags), jnp.zeros((), jnp.int32))

    return jnp.stack([total(name) for name in INVARIANTS])


def not_finite(tree: Any) -> dict[str, jax.Array]:
    """Where the float leaves of a tree are not finite, by their paths."""
    return {
        jax.tree_util.keystr(path, simple=True, separator="."): ~jnp.isfinite(leaf)
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    }


def with_finite_waits(state: EnvState) -> EnvState:
    """The state with intended infinities set to 0: waits of MEDs that never return, and courtesy that nobody needs."""
    vehicles, meds = state.vehicles, state.meds
    waits = meds.ready_in_s, vehicles.courtesy_left, vehicles.courtesy_right
    ready, left, right = (jnp.where(values == jnp.inf, 0.0, values) for values in waits)
    vehicles = vehicles.replace(courtesy_left=left, courtesy_right=right)
    return state.replace(meds=meds.replace(ready_in_s=ready), vehicles=vehicles)


def lengths_of(state: EnvState, params: EnvParams) -> jax.Array:
    """Length of the vehicle in each slot, (N,) m."""
    return params.drivers.vehicle_length[state.vehicles.kind]


def check_lanes(before: Vehicles, after: Vehicles, length: jax.Array) -> Flags:
    """Checks overlaps and passing within a lane, in the road order after the tick; length (N,) m."""
    slots = after.x.shape[0]
    # One packed word of lane, place and slot sorts ten times as fast as several arrays. Packing truncates places to a
    # few millimetres. Two vehicles that close in a lane overlap in either order.
    slot_bits = (slots - 1).bit_length()
    places = 2 ** (29 - slot_bits)
    scale = places / (1.0 + jnp.max(jnp.where(after.active, after.x, 0.0)))
    place = jnp.clip(after.x * scale, 0, places - 1).astype(jnp.uint32)
    lane = jnp.where(after.active, after.lane, 7).astype(jnp.uint32)  # 7: no lane
    order = jnp.sort(((lane * places + place) << slot_bits) | jnp.arange(slots, dtype=jnp.uint32))
    order = (order & (2**slot_bits - 1)).astype(jnp.int32)
    is_in = jnp.where(after.active, after.lane, -1)
    was_in = jnp.where(before.active, before.lane, -1)
    columns = is_in, after.x, after.x - length, was_in, before.x
    lane, x, rear, was_in, was_x = read(columns, order)
    pair = (lane[1:] == lane[:-1]) & (lane[1:] >= 0)
    stayed = (was_in[1:] == lane[1:]) & (was_in[:-1] == lane[:-1])
    return {
        "overlap": {"pairs in road order": pair & (rear[1:] < x[:-1])},
        "passed": {"pairs in road order": pair & stayed & (was_x[1:] < was_x[:-1])},
    }


def stands_open(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Vehicles that stand on a main lane with OPEN_M of road ahead, although they can and want to drive, (N,) bool."""
    vehicles = state.vehicles
    rear = vehicles.x - lengths_of(state, params)
    first, last = lanes_covered(vehicles, params)
    # A vehicle that has begun to change lanes blocks its new lane as well.
    first, last = jnp.minimum(first, vehicles.lane), jnp.maximum(last, vehicles.lane)
    ahead = vehicles.active & (first <= last[:, None]) & (last >= first[:, None])
    ahead &= vehicles.x > vehicles.x[:, None]
    gap = jnp.min(jnp.where(ahead, rear, jnp.inf), axis=1) - vehicles.x
    evs, charging, slots = state.evs, params.charging, config.ev_slots
    powered = jnp.ones_like(vehicles.active).at[slots].set(~evs.is_depleted)
    if state.stands_for_s is not None:
        powered = powered.at[config.gas_slots].set(state.stands_for_s <= 0.0)
    # Acceleration from standstill is the driver's. For a booked EV, the slot controller at its slowest limits it.
    starts = params.drivers.max_acceleration[vehicles.kind]
    slowest = charging.slowest_share * params.fleet.service_speed
    booked = evs.med != NOT_BOOKED

    def at_most(values: jax.Array, bound: jax.Array | float) -> jax.Array:
        bounded = jnp.where(booked, jnp.minimum(values[slots], bound), values[slots])
        return values.at[slots].set(bounded)

    starts = at_most(starts, charging.speed_rate * slowest)
    wanted = at_most(vehicles.desired_speed, slowest)
    noise = params.drivers.acceleration_noise[vehicles.kind]
    powered &= starts + jnp.minimum(vehicles.acceleration_noise, -3.0 * noise) > 0.1
    powered &= wanted > 4.0 * STANDS_M_PER_S
    stands = vehicles.active & powered & (vehicles.speed < STANDS_M_PER_S)
    return stands & (vehicles.lane < config.num_lanes) & (gap > OPEN_M)


def check_state(state: EnvState, config: EnvConfig, params: EnvParams) -> Flags:
    """Checks what holds at every instant, except overlaps (`check_lanes`)."""
    vehicles, evs, meds = state.vehicles, state.evs, state.meds
    active, lane, x, road = vehicles.active, vehicles.lane, vehicles.x, params.road
    ev_active, med_active = active[config.ev_slots], active[config.med_slots]

    along_ramp = x[:, None] - road.ramp_x_m[None, :]
    on_ramp = (along_ramp >= 0.0) & (along_ramp <= road.acceleration_lane_m + ROUNDING_M)
    merges = (lane == config.num_lanes) & on_ramp.any(axis=1)
    on_lane = (lane >= 0) & ((lane < config.num_lanes) | merges)
    inside = (x >= 0.0) & (x <= road.length_m)

    drives = (meds.status == MERGING) | (meds.status == IN_SERVICE) | (meds.status == LEAVING)
    unknown = (meds.status < AT_DEPOT) | (meds.status > LEAVING)
    surplus = (jnp.arange(config.num_meds) >= params.fleet.size) & (meds.status != RETIRED)

    booked = evs.med != NOT_BOOKED
    med, charging_slot = jnp.clip(evs.med, 0, config.num_meds - 1), evs.charging_slot
    med_capacity = params.med_capacity_j
    has_energy = meds.energy_j > params.fleet.reserve_soc * med_capacity
    serves = med_active & (meds.status == IN_SERVICE) & has_energy
    exists = (
        (evs.med >= 0)
        & (evs.med < config.num_meds)
        & (charging_slot >= 0)
        & (charging_slot < len(CHARGING_SLOTS))
    )
    slot_index = jnp.where(booked, evs.med * len(CHARGING_SLOTS) + charging_slot, -1)
    same = (slot_index[:, None] == slot_index[None, :]) & booked[:, None]
    return {
        "boxes": {"pairs": overlapping_vehicles(vehicles, params)},
        "speed": {"below 0": active & (vehicles.speed < 0.0)},
        "road": {"no lane": active & ~on_lane, "beyond the road": active & ~inside},
        "vehicles": {
            "on the road, by a MED's status": med_active != drives,
            "a MED's status": unknown,
            "MED beyond the fleet": surplus,
            "no such depot": (meds.depot < 0) | (meds.depot >= config.num_depots),
            "queue below 0": state.queue < 0,
        },
        "bookings": {
            "EVs on one charging slot": booked & (jnp.sum(same, axis=1) > 1),
            "MED without charging slot or the reverse": booked != (charging_slot != NOT_BOOKED),
            "no such charging slot": booked & ~exists,
            "EV off the road": booked & ~ev_active,
            "EV without energy": booked & evs.is_depleted,
            "MED not in service": booked & ~serves[med],
            "charges unbooked": evs.is_charging & ~booked,
        },
        "soc": {
            # Compare energies, since a division may round to just above 1.
            "EV": (evs.energy_j < 0.0) | (evs.energy_j > params.ev_capacity_j),
            "MED": (meds.energy_j < 0.0) | (meds.energy_j > med_capacity),
            "depleted, with energy": ev_active & evs.is_depleted & (evs.energy_j > 0.0),
        },
        "finite": not_finite(with_finite_waits(state)),
    }


def check_instant(state: EnvState, config: EnvConfig, params: EnvParams) -> Flags:
    """Checks what holds at every instant, including overlaps."""
    vehicles = state.vehicles
    lanes = check_lanes(vehicles, vehicles, lengths_of(state, params))
    return {**lanes, **check_state(state, config, params)}


def check_entry(
    before: EnvState, begun: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[Flags, Ledger]:
    """Checks that before the first tick of a round only entries and new bookings happen."""
    old, new = before.vehicles, begun.vehicles
    enters = new.active & ~old.active
    where = entries(params.road, config.num_lanes)
    at = (new.x[:, None] == where.x) & (new.lane[:, None] == where.lane) & enters[:, None]
    fields = ("active", "x", "speed", "lane", "desired_speed", "lateral_offset")
    ordinary = jnp.sum(at[config.med_slots.stop :], axis=0)

    evs, was, ev_slots = begun.evs, before.evs, config.ev_slots
    newcomer = enters[ev_slots]
    kept = (evs.med == was.med) & (evs.charging_slot == was.charging_slot)
    arrival, demand = evs.energy_j / params.ev_capacity_j, params.demand
    slack = ROUNDING * demand.arrival_soc_high
    low, high = demand.arrival_soc_low - slack, demand.arrival_soc_high + slack
    served = jnp.array([*config.ramp_depots, -1])[begun.meds.ramp]
    waited = (before.meds.status == QUEUED) | (before.meds.status == AT_DEPOT)
    to_exit = new.destination - new.x - params.road.exit_lane_m
    lanes = jnp.maximum(config.num_lanes - new.lane, 1)  # lanes to cross, plus one
    crosses = lanes * params.lane_change.exit_view_m
    bound = (new.destination < params.road.length_m) & (to_exit < crosses)
    departs = begun.meds.status == LEAVING
    parts = bound[ev_slots] | evs.stops | departs[jnp.maximum(was.med, 0)]
    moved = {field: old.active & (getattr(old, field) != getattr(new, field)) for field in fields}
    flags = {
        "motion": moved,
        "vehicles": {
            "comes in at no entry": enters & ~at.any(axis=1),
            "several at one entry": jnp.sum(at, axis=0) > 1,
            "queue loses vehicles": begun.queue < before.queue - ordinary,
            "MED out of nowhere": enters[config.med_slots] & ~waited,
            "MED of another depot": enters[config.med_slots] & (served != before.meds.depot),
        },
        "bookings": {
            "changed": ~newcomer & (was.med != NOT_BOOKED) & ~kept & (evs.med != NOT_BOOKED),
            "given up": ~newcomer & (was.med != NOT_BOOKED) & (evs.med == NOT_BOOKED) & ~parts,
        },
        "energy": {
            "arrival": newcomer & ((arrival < low) | (arrival > high)),
            "EV at rest": ~newcomer & (evs.energy_j != was.energy_j),
            "MED at rest": begun.meds.energy_j != before.meds.energy_j,
        },
    }
    return flags, entry_ledger(before, begun, params.road.length_m)


def check_tick(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[Flags, Ledger]:
    """Checks one tick: bodies move plausibly, vehicles leave only by a way out, and energy is conserved."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    both, travel = old.active & new.active, new.x - old.x
    farthest = 0.5 * (old.speed + new.speed) * dt
    slack = ROUNDING_M + ROUNDING * farthest + POSITION_RTOL * new.x
    limit = jnp.maximum(params.motion.max_braking, jnp.max(params.drivers.max_acceleration)) * dt
    jumps = jnp.abs(new.speed - old.speed) > limit * (1.0 + ROUNDING) + ROUNDING
    hop = new.lane - old.lane
    gone = old.active & ~new.active
    ran_out = jnp.zeros_like(gone).at[config.ev_slots].set(before.evs.is_depleted)
    past = (new.x > params.road.length_m) | at_exit(new, config, params)
    evs, was = after.evs, before.evs
    kept = (evs.med == was.med) & (evs.charging_slot == was.charging_slot)
    energy, ledger = tick_ledger(before, after, config, params)
    flags = {
        **check_lanes(old, new, lengths_of(after, params)),
        "motion": {
            "backward": old.active & (travel < 0.0),
            "farther than its speeds": old.active & (travel > farthest + slack),
            "speed jumps": old.active & jumps,
            "several lanes": old.active & (jnp.abs(hop) > 1),
            "onto an acceleration lane": old.active & (hop != 0) & (new.lane >= config.num_lanes),
            "another vehicle": both & (new.desired_speed != old.desired_speed),
            "another kind": both & (new.kind != old.kind),
        },
        "vehicles": {
            "appears": new.active & ~old.active,
            "vanishes": gone & ~(past | ran_out),
            "empty, not depleted": (both[config.ev_slots] & (after.evs.energy_j <= 0.0))
            & ~after.evs.is_depleted,
            "gets its energy back": (both & ran_out)[config.ev_slots] & ~after.evs.is_depleted,
        },
        "bookings": {"changed": (evs.med != NOT_BOOKED) & ~kept},
        "energy": energy,
    }
    return flags, ledger
