"""Traffic demand: Poisson arrivals, entries, and filling the road at reset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from medjax.numerics.sums import block_fma
from medjax.traffic.following import FREE_GAP_M, braking_weight, by_kind
from medjax.traffic.sections import Sections, place, sections_of
from medjax.world.kinds import EVS, FUELLED, GAS_KINDS, kinds_in
from medjax.world.params import (
    DemandParams,
    DriverParams,
    EnvConfig,
    EnvParams,
    RoadParams,
    Scalar,
)

# Cap on arrivals per entry and round; with 2 expected, more come once in 4,200 rounds.
MOST_ARRIVALS = 8
# Desired speeds are cut off at this many standard deviations.
SPEED_SPREAD = 2.5
# A reset adapts speeds to those of so many vehicles ahead; even on a full road the next one changes nothing.
SLOWER_LEADERS = 12


def entry_rates(demand: DemandParams, num_lanes: int, time_s: Scalar) -> jax.Array:
    """Demand at each entry at time_s since the episode's start, vehicles/s, `(num_lanes + num_ramps,)`."""
    mainline, ramps = demand.flows(time_s)
    return jnp.concatenate([jnp.full((num_lanes,), mainline / num_lanes), ramps]) / 3600.0


def surge_starts(drawn: jax.Array, demand: DemandParams) -> jax.Array:
    """Start of each surge, `(num_surges,)` s since the episode's start, from `EnvState.surges`, `(num_surges, 2)`."""
    return demand.surge_from_s + drawn[:, 0] * (demand.surge_until_s - demand.surge_from_s)


def surge_factors(
    drawn: jax.Array, config: EnvConfig, demand: DemandParams, time_s: Scalar
) -> jax.Array:
    """Factors of the demand at each entry through the surges of an episode, `(num_lanes + num_ramps,)`.

    Each surge has a ramp and a start of its own, drawn uniformly; surges of one ramp multiply. They do not depend on
    what dispatchers do, who do not know them either: `entry_rates` is the demand that is known.

    Args:
      drawn: `(num_surges, 2)`, `EnvState.surges`.
      time_s: since the episode's start.
    """
    after_s = time_s - surge_starts(drawn, demand)
    under_way = (after_s >= 0.0) & (after_s < demand.surge_s)
    ramp = jnp.minimum((drawn[:, 1] * config.num_ramps).astype(jnp.int32), config.num_ramps - 1)
    entry = jnp.arange(config.num_entries, dtype=jnp.int32)
    surges = under_way & (entry[:, None] == config.num_lanes + ramp)
    return jnp.prod(jnp.where(surges, demand.surge_factor, 1.0), axis=1)


def poisson_arrivals(uniform: jax.Array, expected: jax.Array) -> jax.Array:
    """Poisson counts by inversion, int32; one uniform draw per count, no rejection loop.

    Args:
      uniform: in [0, 1); expected: mean counts; equal shapes.

    Returns:
      Counts, capped at MOST_ARRIVALS.
    """
    term = jnp.exp(-expected)
    below = term
    count = jnp.zeros(jnp.shape(uniform), jnp.int32)
    for k in range(1, MOST_ARRIVALS + 1):
        count += uniform >= below
        term = term * expected / k
        below = below + term
    return count


def desired_speeds(normal: jax.Array, kind: jax.Array, drivers: DriverParams) -> jax.Array:
    """Desired speeds, m/s, from standard normal draws of the same shape."""
    spread = jnp.clip(normal, -SPEED_SPREAD, SPEED_SPREAD) * drivers.desired_speed_std[kind]
    return jnp.maximum(drivers.desired_speed[kind] + spread, 0.5 * drivers.desired_speed[kind])


def shares_on_road(demand: DemandParams, drivers: DriverParams) -> tuple[Scalar, ...]:
    """Turns `demand.class_shares`, shares of arrivals, into shares of density: slow vehicles stay longer."""
    shares = list(demand.class_shares)
    for kinds in (kinds_in(EVS), GAS_KINDS):
        times = [shares[kind] / drivers.desired_speed[kind] for kind in kinds]
        for kind, time in zip(kinds, times, strict=True):
            shares[kind] = time / sum(times)
    return tuple(shares)


def drawn_kinds(uniform: jax.Array, is_ev: jax.Array, shares: Sequence[Scalar]) -> jax.Array:
    """Vehicle kinds, int32, from uniform draws and EV flags of one shape; shares like `demand.class_shares`."""

    def drawn(kinds: tuple[int, ...]) -> jax.Array | int:
        kind: jax.Array | int = kinds[-1]
        for last in range(len(kinds) - 1, 0, -1):
            below = sum(shares[index] for index in kinds[:last])
            kind = jnp.where(uniform < below, kinds[last - 1], kind)
        return kind

    return jnp.where(is_ev, drawn(kinds_in(EVS)), drawn(GAS_KINDS)).astype(jnp.int32)


class Entries(NamedTuple):
    """Entries of a road, `(K,)` each: lanes at x = 0, then ramps."""

    x: jax.Array  # m
    lane: jax.Array  # int32


def entries(road: RoadParams, num_lanes: int) -> Entries:
    """The entries of a road: the start of each lane, then of each acceleration lane."""
    x = jnp.concatenate([jnp.zeros((num_lanes,), jnp.float32), road.ramp_x_m])
    lanes, ramps = (
        jnp.arange(num_lanes, dtype=jnp.int32),
        jnp.full_like(road.ramp_x_m, num_lanes, jnp.int32),
    )
    return Entries(x, jnp.concatenate([lanes, ramps]))


def assign_slots(admitted: jax.Array, free: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Assigns free slots to admitted entries, in order.

    Args:
      admitted: (K,) bool, entries where a vehicle of this class may enter.
      free: (C,) bool, free slots of the class.

    Returns:
      (entry: (C,) int32, the entry whose vehicle a slot receives, -1 for none;
       placed: (K,) bool, admitted entries that got a slot).
    """
    num_entries = admitted.shape[0]
    place_in_line = jnp.cumsum(admitted.astype(jnp.int32)) - 1
    free_before = jnp.cumsum(free.astype(jnp.int32))
    placed = admitted & (place_in_line < jnp.sum(free, dtype=jnp.int32))
    in_line = jnp.full((num_entries,), -1, jnp.int32)
    in_line = in_line.at[jnp.where(placed, place_in_line, num_entries)].set(
        jnp.arange(num_entries, dtype=jnp.int32), mode="drop"
    )
    turn = free_before - 1
    takes = free & (turn < num_entries)
    return jnp.where(takes, in_line[jnp.clip(turn, 0, num_entries - 1)], -1), placed


class InitialTraffic(NamedTuple):
    """Vehicles of a filled road, `(C,)` each."""

    x: jax.Array  # m
    lane: jax.Array  # int32
    speed: jax.Array  # m/s
    active: jax.Array  # bool


def expected_vehicles(demand: DemandParams, road: RoadParams, speed: Scalar) -> jax.Array:
    """Vehicles on the road in equilibrium, if all drive at this speed, m/s."""
    return sections_of(demand, road).total / (3600.0 * speed)


def fill_road(
    key: jax.Array, kind: jax.Array, desired_speed: jax.Array, num_lanes: int, params: EnvParams
) -> InitialTraffic:
    """Fills the lanes to match the demand, in closed form and without collisions.

    A Poisson number of vehicles goes to a grid of places, lane by lane, each moved forward by up to half the
    spacing. The grid begins anywhere, and is as dense as the flow past each place. One shuffle of the slots mixes EVs
    and gas vehicles.

    Args:
      key: random key.
      kind: (C,) int32, of each slot, an EV's or a gas vehicle's.
      desired_speed: (C,) m/s.

    Returns:
      Initial traffic of the C slots.
    """
    count_key, share_key, shuffle_key, jitter_key, begin_key = jax.random.split(key, 5)
    sections = sections_of(params.demand, params.road)
    is_ev = jnp.isin(kind, jnp.array(kinds_in(EVS)))
    evs, gas = _drawn_counts((count_key, share_key), is_ev, num_lanes, sections, params)
    evs_so_far, gas_so_far = (jnp.cumsum(each, dtype=jnp.int32) for each in (is_ev, ~is_ev))
    class_rank = jnp.where(is_ev, evs_so_far, gas_so_far) - 1
    active = class_rank < jnp.where(is_ev, evs, gas)

    in_place = _shuffled_slots(shuffle_key, active)
    places = np.arange(kind.shape[0], dtype=np.int32)
    per_lane = jnp.maximum(jnp.ceil((evs + gas) / num_lanes), 1.0)
    jitter = jax.random.uniform(jitter_key, kind.shape, jnp.float32, maxval=0.5)
    # Rows are slanted: vehicles of neighbouring lanes start beside each other's gaps.
    row = np.float32(places // num_lanes + places % num_lanes * np.float32(1.0 / num_lanes))
    upstream = block_fma((row + jitter) * (1.0 / per_lane))
    upstream += jax.random.uniform(begin_key, (), jnp.float32)
    upstream -= jnp.floor(upstream)  # share of all vehicles
    x = place(upstream, sections)

    def ahead(values: jax.Array) -> jax.Array:
        """Values of the vehicle in the next place of the lane; after the last place comes the first."""
        first = jnp.resize(values[:num_lanes], values.shape)
        follows = places + num_lanes < evs + gas
        return jnp.where(follows, jnp.roll(values, -num_lanes, axis=0), first)

    filled = jnp.less(places, evs + gas)
    speed = _initial_speeds(x, filled, ahead, kind[in_place], desired_speed[in_place], params)
    of_slot = jnp.zeros_like(places).at[in_place].set(places, unique_indices=True)
    return InitialTraffic(x[of_slot], of_slot % num_lanes, speed[of_slot], active)


def _drawn_counts(
    keys: tuple[jax.Array, jax.Array],
    is_ev: jax.Array,
    num_lanes: int,
    sections: Sections,
    params: EnvParams,
) -> tuple[jax.Array, jax.Array]:
    """Numbers of EVs and gas vehicles on the road, () each, limited by slots and by room on the road."""
    demand, drivers = params.demand, params.drivers
    slots, num_ev_slots = is_ev.shape[0], jnp.sum(is_ev, dtype=jnp.int32)
    shares = jnp.stack(demand.class_shares)
    seconds = shares / drivers.desired_speed  # a metre takes, times the kind's share
    gas, evs = (
        sections.total / 3600.0 * sum(seconds[k] for k in kinds)
        for kinds in (GAS_KINDS, kinds_in(EVS))  # if all vehicles were of this class
    )
    # If EVs and others are equally fast, this gives exactly the total of either and the share of arrivals.
    more = demand.ev_share * (evs - gas)
    expected = gas + more
    ev_share = demand.ev_share + (1.0 - demand.ev_share) * more / jnp.maximum(expected, 1e-6)
    # Normal approximations of the Poisson and binomial counts: closed-form, and good above 20.
    total = expected + jnp.sqrt(expected) * jax.random.normal(keys[0], (), jnp.float32)
    # Whatever the demand, the half of the spacing that jitter leaves must hold more than a standing vehicle.
    # MEDs are not filled in.
    rooms = jnp.where(shares > 0.0, drivers.vehicle_length + drivers.min_gap, 0.0)
    room = jnp.max(rooms[jnp.array(kinds_in(EVS, FUELLED))])
    densest_m = sections.evenness * params.road.length_m
    total = jnp.clip(jnp.round(total), 0, num_lanes * jnp.floor(densest_m / (2.5 * room)))
    spread = jnp.sqrt(total * ev_share * (1.0 - ev_share))
    evs = jnp.round(total * ev_share + spread * jax.random.normal(keys[1], (), jnp.float32))
    evs = jnp.clip(evs, 0, jnp.minimum(total, num_ev_slots))
    return evs, jnp.clip(total - evs, 0, slots - num_ev_slots)


def _initial_speeds(
    x: jax.Array,
    filled: jax.Array,
    ahead: Callable[[jax.Array], jax.Array],
    kind: jax.Array,
    desired_speed: jax.Array,
    params: EnvParams,
) -> jax.Array:
    """Speeds at which IDM brakes comfortably at most, `(C,)` m/s; `ahead` gives values of the vehicle ahead of each.

    Whatever the drivers' parameters, everybody can slow down to the slowest speed at four fifths of max_braking.
    """
    drivers = params.drivers
    length, min_gap, time_headway = (
        by_kind(kind, values)
        for values in (drivers.vehicle_length, drivers.min_gap, drivers.time_headway)
    )
    gap = jnp.where(ahead(x) > x, ahead(x - length) - x, FREE_GAP_M)
    room = jnp.maximum(gap - min_gap, 0.0)
    alone = jnp.minimum(desired_speed, room / time_headway)
    # Behind a slower leader, IDM's desired gap min_gap + v T + weight v (v - v_leader) may be this much longer.
    longer = jnp.sqrt(drivers.comfortable_deceleration / drivers.max_acceleration)
    weight = by_kind(
        kind, braking_weight(drivers.max_acceleration, drivers.comfortable_deceleration)
    )
    spare = jnp.maximum(block_fma(jnp.maximum(gap, 0.0) * by_kind(kind, longer)) - min_gap, 0.0)

    def comfortable(limit: jax.Array) -> jax.Array:
        """Highest speeds up to these limits."""
        speed = limit
        for _ in range(SLOWER_LEADERS):
            headway = time_headway - block_fma(weight * ahead(speed))
            root = jnp.sqrt(block_fma(jnp.square(headway)) + block_fma(4.0 * weight * spare))
            speed = jnp.minimum(limit, 2.0 * spare / jnp.maximum(headway + root, 1e-6))
        return speed

    slowest = jnp.min(
        jnp.where(filled, comfortable(alone), jnp.inf), initial=jnp.max(desired_speed)
    )
    braked = jnp.square(slowest) + block_fma(2.0 * 0.8 * params.motion.max_braking * room)
    return comfortable(jnp.minimum(alone, jnp.sqrt(braked)))


def _shuffled_slots(key: jax.Array, active: jax.Array) -> jax.Array:
    """Slots in random order, active ones first, (C,) int32 from (C,) bool."""
    slots = active.shape[0]
    # Shuffles by one sort of packed keys: random high bits, slot in the low bits, inactive last.
    bits = max(1, (slots - 1).bit_length())
    tickets = jax.random.bits(key, (slots,), jnp.uint32) >> (bits + 1) << bits
    tickets = jnp.where(active, tickets, jnp.uint32(2**31))
    shuffled = jnp.sort(tickets | jnp.arange(slots, dtype=jnp.uint32))
    return (shuffled & jnp.uint32(2**bits - 1)).astype(jnp.int32)
