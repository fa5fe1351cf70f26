"""Energy and other books kept from states alone.

What a battery took in is what it holds more than before, plus what driving cost it. That cost is worked out here by the
work of eqs (7)-(8) in another form: forces times the way, and the change of kinetic energy. A battery that is
full or empty hides a part of what flowed, so flows are intervals, `Flow`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from medjax.world.kinds import GAS_KINDS, KINDS
from medjax.world.params import BodyParams, EnvConfig, EnvParams, RoadParams
from medjax.world.state import AT_DEPOT, NOT_BOOKED, RETIRED, EnvState, Vehicles

GRAVITY = 9.81  # m/s^2
# Energies are float32 numbers of up to a full battery and change twice a tick: each change rounds by at most half a
# unit in the last place, 6e-8 of the capacity. Ten times that is a twentieth of what a tick of driving costs.
OF_CAPACITY = 1e-6
# What flows in a tick is the result of a dozen float32 operations.
OF_FLOW = 1e-5
# Positions are float32 of up to thousands.
ROUNDING_M = 2e-3


class Books(struct.PyTreeNode):
    """What happened in a decision, added up from states; float32, () unless said."""

    entered: jax.Array  # (num_kinds,)
    left: jax.Array  # (num_kinds,)
    depleted: jax.Array
    ev_seconds: jax.Array
    ev_distance_m: jax.Array
    soc_seconds: jax.Array
    exit_soc: jax.Array
    low_exits: jax.Array
    ev_delay_s: jax.Array
    gas_seconds: jax.Array  # (num_gas_kinds,)
    gas_distance_m: jax.Array  # (num_gas_kinds,)
    gas_delay_s: jax.Array
    med_seconds: jax.Array
    vehicle_ticks: jax.Array
    evs_served: jax.Array
    meds_dispatched: jax.Array
    lane_changes: jax.Array
    missed_exits: jax.Array
    charging_stops: jax.Array
    sent_j: jax.Array  # (2,) at least, at most
    received_j: jax.Array  # (2,)
    ev_driving_j: jax.Array  # (2,)
    ev_cruising_j: jax.Array  # (2,)
    med_driving_j: jax.Array  # (2,)


class Flow(NamedTuple):
    """At least and at most so much, J."""

    low: jax.Array
    high: jax.Array


def total(values: jax.Array) -> jax.Array:
    """Sum, () float32."""
    return jnp.sum(values, dtype=jnp.float32)


def sums_by_class(values: jax.Array, config: EnvConfig) -> jax.Array:
    """Sums over MEDs, EVs and gas vehicles, (3,) float32."""
    return jnp.stack([total(values[slots]) for slots in config.class_slots.values()])


def sums_by_kind(values: jax.Array, kind: jax.Array) -> jax.Array:
    """Sums over the vehicles of each kind, (num_kinds,) float32."""
    return jnp.zeros((len(KINDS),), jnp.float32).at[kind].add(values.astype(jnp.float32))


def entry_books(before: EnvState, begun: EnvState, length_m: Any) -> Books:
    """Of dispatch, entries, and exits driven past."""
    past = before.vehicles.active & (before.vehicles.x > before.vehicles.destination)
    sent = (before.meds.status == AT_DEPOT) & (begun.meds.status != AT_DEPOT)
    come = begun.vehicles.active & ~before.vehicles.active
    by_gas_kind = jnp.zeros((len(GAS_KINDS),))
    flows = (name for name in Books.__dataclass_fields__ if name.endswith("_j"))
    books = dict.fromkeys(Books.__dataclass_fields__, jnp.zeros(()))
    books |= {"left": jnp.zeros((len(KINDS),))} | dict.fromkeys(flows, jnp.zeros((2,)))
    books |= {"gas_seconds": by_gas_kind, "gas_distance_m": by_gas_kind}
    books |= {"entered": sums_by_kind(come, begun.vehicles.kind), "meds_dispatched": total(sent)}
    books |= {"missed_exits": total(past & (before.vehicles.destination < length_m))}
    return Books(**books)


def driving(
    before: Vehicles,
    after: Vehicles,
    slots: slice,
    body: BodyParams,
    road: RoadParams,
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Energy that a tick of driving takes from each battery, and how far float32 may be off it, (C,) J each."""
    v0, v1 = before.speed[slots], after.speed[slots]
    way = 0.5 * (v0 + v1) * dt
    rolling = body.mass_kg * GRAVITY * body.rolling_resistance * way
    climbing = body.mass_kg * GRAVITY * jnp.sin(road.slope) * way
    drag = (
        road.air_density * body.drag_coefficient * body.frontal_area_m2 * (v0 + v1) ** 2 * way / 8.0
    )
    inertia = body.mass_kg * body.rotational_inertia_factor
    kinetic = 0.5 * inertia * (v1 - v0) * (v1 + v0)
    wheels = rolling + climbing + drag + kinetic
    auxiliary = body.auxiliary_w * dt
    used, regained = wheels / body.drivetrain_efficiency, wheels * body.regeneration_efficiency
    battery = jnp.where(wheels > 0.0, used, regained) + auxiliary
    # The difference of two speeds is as exact as they are.
    gross = (
        rolling
        + jnp.abs(climbing)
        + drag
        + jnp.abs(kinetic)
        + 2e-2 * inertia * OF_FLOW * (v0 + v1) ** 2
    )
    off = OF_FLOW * (gross / body.drivetrain_efficiency + auxiliary)
    on_road = before.active[slots]
    return jnp.where(on_road, battery, 0.0), jnp.where(on_road, off, 0.0)


Change = tuple[jax.Array, jax.Array, jax.Array, jax.Array]


def _change(
    before_j: jax.Array, after_j: jax.Array, driven: tuple[jax.Array, jax.Array], capacity: Any
) -> Change:
    """What batteries gained but for driving, how far float32 may be off it, J, and who is full and empty; (C,) each."""
    gain = after_j - before_j + driven[0]
    slack = OF_CAPACITY * capacity + driven[1] + OF_FLOW * jnp.abs(gain)
    return gain, slack, after_j >= capacity, after_j <= 0.0


def _received(change: Change, most: jax.Array) -> Flow:
    """What came into EVs' batteries, (E,) each, `most` at most."""
    gain, slack, full, empty = change
    # A full battery takes no charge beyond its room, so a lack there is braking energy that found none. An empty one
    # may have got something, and spent it.
    low = jnp.where(full, jnp.maximum(gain, 0.0), jnp.where(empty, jnp.minimum(gain, 0.0), gain))
    high = jnp.where(full, jnp.maximum(gain, 0.0), jnp.where(empty, jnp.minimum(gain, most), gain))
    return Flow(low - slack, high + slack)


def _sent(change: Change, most: jax.Array) -> Flow:
    """What MEDs gave, (M,) each, `most` at most."""
    gain, slack, full, empty = change
    # A full one may have lost braking energy that found no room; an empty one drives on what it does not have.
    low = jnp.where(full, jnp.minimum(-gain, 0.0), -gain)
    high = jnp.where(empty, jnp.maximum(-gain, most), -gain)
    return Flow(low - slack, high + slack)


def cruising(
    before: Vehicles, after: Vehicles, slots: slice, body: BodyParams, road: RoadParams
) -> tuple[jax.Array, jax.Array]:
    """As `driving`, what the way of a tick takes at everyone's own desired speed, (C,) J each."""
    steady = before.replace(speed=before.desired_speed)
    seconds = (after.x - before.x)[slots] / before.desired_speed[slots]
    power, off = driving(steady, steady, slots, body, road, 1.0)
    return power * seconds, off * seconds


def tick_flows(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """Energy that flowed in one tick: flags for what cannot be, and (2,) J at least and at most, by name."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    evs, was, link = after.evs, before.evs, params.link
    slot = params.charging.slot_power_w * dt
    # Losses in the EV's own coil remain however strong the coupling.
    best = link.load_ohm / (link.load_ohm + link.ev_resistance_ohm)
    charges = (was.med != NOT_BOOKED) & evs.served
    takes = jnp.where(charges, best * slot, 0.0)
    partner = charges[:, None] & (was.med[:, None] == jnp.arange(config.num_meds))
    gives = slot * jnp.sum(partner, axis=0)

    road, capacity = params.road, params.med_capacity_j
    of_evs, at_cruise = (
        jax.tree.map(lambda each: jnp.where(was.is_depleted, 0.0, each), energy)  # without motor
        for energy in (
            driving(old, new, config.ev_slots, params.ev, road, dt),
            cruising(old, new, config.ev_slots, params.ev, road),
        )
    )
    received = _received(_change(was.energy_j, evs.energy_j, of_evs, params.ev_capacity_j), takes)
    of_meds = driving(old, new, config.med_slots, params.med, road, dt)
    sent = _sent(_change(before.meds.energy_j, after.meds.energy_j, of_meds, capacity), gives)
    driven = {"ev_driving_j": of_evs, "ev_cruising_j": at_cruise, "med_driving_j": of_meds}
    above_reserve = before.meds.energy_j - params.fleet.reserve_soc * capacity
    arrived = jnp.sum(jnp.where(partner, received.low[:, None], 0.0), axis=0)
    too_much = partner.any(axis=0) & (arrived > best * sent.high)
    wrong = {
        "EV loses": received.high < 0.0,
        "EV gains from nowhere": received.low > takes * (1.0 + OF_FLOW),
        "MED gains": sent.high < 0.0,
        "MED loses": sent.low > gives * (1.0 + OF_FLOW),
        "MED below its reserve": (gives > 0.0) & (sent.low > jnp.maximum(above_reserve, 0.0)),
        "more arrives than the link lets through": too_much,
    }

    def both(flow: Flow, concerned: jax.Array) -> jax.Array:
        return jnp.stack([total(jnp.where(concerned, bound, 0.0)) for bound in flow])

    flows = {"sent_j": both(sent, gives > 0.0), "received_j": both(received, charges)}
    bounds = {name: (value - off, value + off) for name, (value, off) in driven.items()}
    return wrong, flows | {name: jnp.stack([*map(total, pair)]) for name, pair in bounds.items()}


def ways_home(state: EnvState, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Energy that the way from where each MED left the road to its depot takes, (M,) J: steady, on the level."""
    if config.num_depots == 1:
        return jnp.zeros((config.num_meds,))
    speed, slots = params.fleet.return_speed, config.med_slots
    steady = state.vehicles.replace(
        speed=jnp.full_like(state.vehicles.speed, speed),
        active=jnp.ones_like(state.vehicles.active),
    )
    power, _ = driving(steady, steady, slots, params.med, params.road.replace(slope=0.0), 1.0)
    depots, ramp_x = np.array(config.ramp_depots), params.road.ramp_x_m
    served = [np.flatnonzero(depots == depot) for depot in range(config.num_depots)]
    middles = jnp.stack([jnp.mean(ramp_x[ramps]) for ramps in served])
    return power * jnp.abs(state.vehicles.x[slots] - middles[state.meds.depot]) / speed


def at_exit(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Who is in the rightmost lane, beside the deceleration lane of an exit that is its destination, `(N,)` bool."""
    road = params.road
    before = road.exit_x_m[None, :] - vehicles.x[:, None]
    beside = (before >= -ROUNDING_M) & (before <= road.exit_lane_m + ROUNDING_M)
    own = beside & (vehicles.destination[:, None] == road.exit_x_m)
    centred = jnp.abs(vehicles.lateral_offset) < 0.25 * road.lane_width_m
    return own.any(axis=1) & centred & (vehicles.lane == config.num_lanes - 1)


def tick_books(
    before: EnvState, after: EnvState, config: EnvConfig, params: EnvParams
) -> tuple[dict[str, jax.Array], Books]:
    """Books of one tick, and flags for flows that cannot be, by what is wrong."""
    old, new, dt = before.vehicles, after.vehicles, config.tick_s
    evs, was = after.evs, before.evs
    wrong, flows = tick_flows(before, after, config, params)
    gone = old.active & ~new.active
    on_energy = jnp.ones_like(gone).at[config.ev_slots].set(~was.is_depleted)
    past = (new.x > params.road.length_m) | at_exit(new, config, params)
    left = gone & on_energy & past
    bound = (new.destination[:, None] == params.road.exit_x_m).any(axis=1)[config.ev_slots]
    travelled = jnp.where(old.active, new.x - old.x, 0.0)
    soc = evs.energy_j / params.ev_capacity_j
    # Who leaves in a tick was there for it, too.
    there, gas = sums_by_class(old.active, config), jnp.array(GAS_KINDS)
    distance = sums_by_class(travelled, config)
    lost = jnp.where(old.active, dt - travelled / old.desired_speed, 0.0)
    delay = sums_by_class(lost, config)
    low = evs.energy_j < params.charging.request_soc * params.ev_capacity_j
    on_their_way = (before.meds.status != AT_DEPOT) & (before.meds.status != RETIRED)
    return wrong, Books(
        entered=jnp.zeros((len(KINDS),)),
        left=sums_by_kind(left, old.kind),
        depleted=total(new.active[config.ev_slots] & evs.is_depleted & ~was.is_depleted),
        ev_seconds=there[1] * dt,
        ev_distance_m=distance[1],
        soc_seconds=total(jnp.where(old.active[config.ev_slots], soc, 0.0)) * dt,
        exit_soc=total(jnp.where(left[config.ev_slots], soc, 0.0)),
        low_exits=total(left[config.ev_slots] & (was.stops | low & ~bound)),
        ev_delay_s=delay[1],
        gas_delay_s=delay[2],
        med_seconds=total(on_their_way) * dt,
        gas_seconds=sums_by_kind(old.active, old.kind)[gas] * dt,
        gas_distance_m=sums_by_kind(travelled, old.kind)[gas],
        vehicle_ticks=total(new.active),
        evs_served=total(evs.served & ~was.served),
        meds_dispatched=jnp.zeros(()),
        lane_changes=total(jnp.where(old.active, jnp.abs(new.lane - old.lane), 0)),
        missed_exits=jnp.zeros(()),
        charging_stops=total(left[config.ev_slots] & was.stops),
        **flows,
    )
