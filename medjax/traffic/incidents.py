"""Incidents: a gas vehicle breaks down, brakes, stands in its lane for a while and blocks it, then drives on.

Time and place of an incident follow from the seed of the episode's arrivals, so the state keeps only how long each
vehicle still has to stand. A road without incidents (`EnvConfig.num_incidents`) computes none of this.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma, count_down
from medjax.traffic.arrivals import draw_incidents
from medjax.traffic.exits import distance_to_exit_preparation
from medjax.traffic.following import Drivers, by_kind
from medjax.traffic.intents import Orders
from medjax.traffic.road import NO_LANE, straddled_lane
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState, Vehicles


class Incidents(NamedTuple):
    """When and where the incidents of an episode happen, `(num_incidents,)` each."""

    time_s: jax.Array  # s, since the episode's start
    x: jax.Array  # m


def plan_incidents(seed: jax.Array, params: EnvParams) -> Incidents:
    """Draws an episode's incidents; each number is uniform between its bounds, so equal bounds give it.

    Args:
      seed: `EnvState.arrivals`; in one episode this always returns the same.
    """
    given = params.incidents
    uniform = draw_incidents(seed, given.incident_s.shape[0])

    def between(low: jax.Array, high: jax.Array, share: jax.Array) -> jax.Array:
        return low + block_fma(share * (high - low))

    return Incidents(
        between(given.incident_from_s, given.incident_until_s, uniform[:, 0]),
        between(given.incident_from_x_m, given.incident_until_x_m, uniform[:, 1]),
    )


def comfortable_stop(vehicles: Vehicles, params: EnvParams) -> jax.Array:
    """Distance in which each vehicle stops if it brakes comfortably, v^2 / (2 b), `(N,)` m."""
    comfort = by_kind(vehicles.kind, params.drivers.comfortable_deceleration)
    braking = jnp.minimum(comfort, params.motion.max_braking)
    return block_fma(jnp.square(vehicles.speed) / (2.0 * braking))


def _can_break_down(
    vehicles: Vehicles, stop_m: jax.Array, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """Vehicles within one main lane that come to a stop before they prepare for their exit, `(N,)` bool."""
    width = by_kind(vehicles.kind, params.drivers.vehicle_width)
    offset, lane_width = vehicles.lateral_offset, params.road.lane_width_m
    within = straddled_lane(vehicles.lane, offset, width, lane_width) == NO_LANE
    stays = distance_to_exit_preparation(vehicles, config, params) > stop_m
    return vehicles.active & within & stays & (vehicles.lane < config.num_lanes)


def break_down(
    state: EnvState,
    stands_for_s: jax.Array,
    number: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """Begins the incidents of a round.

    The gas vehicle breaks down that comes to a stop nearest before the incident's place if it brakes comfortably. It
    is within its lane, on the main road, and not about to leave it. Without such a vehicle nothing happens.

    Args:
      stands_for_s: (num_gas,) s, `state.stands_for_s`, which is not None.
      number: () int32, rounds since the episode's start.

    Returns:
      stands_for_s with those of the vehicles that break down.
    """
    incidents, given = plan_incidents(state.arrivals, params), params.incidents
    happens = jnp.floor(incidents.time_s / config.round_s).astype(jnp.int32) == number
    slots, vehicles = config.gas_slots, state.vehicles
    stop_m = comfortable_stop(vehicles, params)
    stop_x = (vehicles.x + stop_m)[slots]
    may, lane = _can_break_down(vehicles, stop_m, config, params)[slots], vehicles.lane[slots]
    # One after the other, so that incidents of the same second and place stop different vehicles.
    for index in range(config.num_incidents):
        in_lane = (given.incident_lane[index] < 0) | (lane == given.incident_lane[index])
        concerned = may & in_lane & (stop_x <= incidents.x[index]) & (stands_for_s <= 0.0)
        nearest = jnp.argmax(jnp.where(concerned, stop_x, -jnp.inf))
        begins = happens[index] & concerned[nearest]
        added = jnp.where(begins, given.incident_s[index], 0.0)
        stands_for_s = stands_for_s.at[nearest].add(added)
    return stands_for_s


def hold(
    vehicles: Vehicles,
    orders: Orders,
    drivers: Drivers,
    stands_for_s: jax.Array,
    config: EnvConfig,
) -> tuple[Vehicles, Orders]:
    """Vehicles and orders of a tick in which broken-down vehicles brake comfortably, then stand in their lanes.

    Args:
      stands_for_s: (num_gas,) s, as in `break_down`.
    """
    slots, broken = config.gas_slots, stands_for_s > 0.0

    def change(values: jax.Array, new: jax.Array | float | bool) -> jax.Array:
        return values.at[slots].set(jnp.where(broken, new, values[slots]))

    noise = change(vehicles.acceleration_noise, 0.0)
    braking = -drivers.comfortable_deceleration[slots]
    orders = orders._replace(
        acceleration=change(orders.acceleration, braking), stay=change(orders.stay, True)
    )
    return vehicles.replace(acceleration_noise=noise), orders


def stand(vehicles: Vehicles, stands_for_s: jax.Array, config: EnvConfig) -> jax.Array:
    """`stands_for_s` after a tick, `(num_gas,)` s: it runs while a vehicle stands, and is 0 off the road.

    Args:
      vehicles: after the tick.
    """
    slots = config.gas_slots
    stands = vehicles.speed[slots] <= 0.0
    left = jnp.where(stands, count_down(stands_for_s, config.tick_s), stands_for_s)
    return jnp.where(vehicles.active[slots], left, 0.0)
