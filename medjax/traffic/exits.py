"""Exits: vehicles' destinations and the lane changes that they require.

A vehicle bound for an exit leaves the main road from the rightmost lane, anywhere along the deceleration lane before
the exit. What it does afterwards is not simulated. A road without exits (`EnvConfig.num_exits`) computes none of this.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma, scale_by
from medjax.world.params import DemandParams, EnvConfig, EnvParams, RoadParams
from medjax.world.state import Vehicles


def next_exit(x: jax.Array, road: RoadParams) -> jax.Array:
    """The next exit after each position, or the road's end, m; of the shape of x, m."""
    nearest = jnp.full_like(x, road.length_m)
    # A loop from the last exit, for the reason given in `medjax.traffic.road.merge_distance`.
    for index in reversed(range(road.exit_x_m.shape[0])):
        nearest = jnp.where(x < road.exit_x_m[index], road.exit_x_m[index], nearest)
    return nearest


def last_exit(x: jax.Array, road: RoadParams) -> jax.Array:
    """The last exit at or before each position, m, -inf before the first one; of the shape of x, m."""
    last = jnp.full_like(x, -jnp.inf)
    for index in range(road.exit_x_m.shape[0]):
        last = jnp.where(x >= road.exit_x_m[index], road.exit_x_m[index], last)
    return last


def deceleration_lanes(road: RoadParams) -> jax.Array:
    """Where the deceleration lane of each exit begins, `(num_exits,)` m."""
    return road.exit_x_m - road.exit_lane_m


def _share_leaving_at(
    index: int, x: jax.Array, demand: DemandParams, road: RoadParams
) -> jax.Array:
    """Share of vehicles from these entries that leave at this exit when they reach it; 0 where it is too near."""
    far_enough = road.exit_x_m[index] - x >= road.exit_notice_m
    return jnp.where(far_enough, demand.exit_share[index], 0.0)


def draw_destinations(
    uniform: jax.Array, x: jax.Array, demand: DemandParams, road: RoadParams
) -> jax.Array:
    """Destinations of vehicles that enter at these positions, m.

    Args:
      uniform: in [0, 1), one draw per vehicle; x: m, same shape.
    """
    exits = range(road.exit_x_m.shape[0])
    return _drawn(uniform, [_share_leaving_at(index, x, demand, road) for index in exits], road)


def draw_destinations_on_road(
    uniform: jax.Array,
    x: jax.Array,
    origin: jax.Array,
    lanes_to_go: jax.Array,
    config: EnvConfig,
    params: EnvParams,
) -> jax.Array:
    """Destinations of vehicles that a reset puts on the road, m.

    Near their exit vehicles are in the lanes that their own preparation would have brought them to (`exit_desire`): the
    share of all lanes that leaves is drawn in these alone, or in more lanes where it is more than they hold. Where the
    lanes of two exits overlap, too few are bound for the second one.

    Args:
      uniform: in [0, 1), one draw per vehicle.
      x, origin: where it is and where it entered, m; lanes_to_go: int32, lane changes to the rightmost lane.
    """
    road, view_m, leaving = params.road, params.lane_change.exit_view_m, []
    for index, lane_x in enumerate(deceleration_lanes(road)):
        to_lane = lane_x - x
        share = _share_leaving_at(index, origin, params.demand, road)
        of_lanes = config.num_lanes * share
        lanes = jnp.maximum(1.0 + jnp.floor(scale_by(to_lane, view_m)), jnp.ceil(of_lanes))
        lanes = jnp.clip(lanes, 1.0, float(config.num_lanes))
        share = jnp.where(lanes_to_go < lanes, jnp.minimum(of_lanes / lanes, 1.0), 0.0)
        leaving.append(jnp.where(to_lane > 0.0, share, 0.0))
    return _drawn(uniform, leaving, road)


def _drawn(uniform: jax.Array, leaving: Sequence[jax.Array], road: RoadParams) -> jax.Array:
    """Destinations, m, from draws in [0, 1) and the shares that leave at each exit when they reach it."""
    destination = jnp.full_like(uniform, road.length_m)
    stays = jnp.ones_like(uniform)  # share still on the road
    for index, share in enumerate(leaving):
        goes_on = stays * (1.0 - share)
        leaves = (uniform >= goes_on) & (uniform < stays)
        destination = jnp.where(leaves, road.exit_x_m[index], destination)
        stays = goes_on
    return destination


def flows_past(
    x: jax.Array, demand: DemandParams, road: RoadParams
) -> tuple[list[jax.Array], list[jax.Array]]:
    """Where the main line and the ramps enter, m, and how many from each pass these positions, vehicles/h, at reset.

    Vehicles that leave at an exit pass the start of its deceleration lane no more.
    """
    mainline, ramps = demand.flows(jnp.zeros((), jnp.float32))
    entry_x, leave_x = [jnp.zeros((), jnp.float32), *road.ramp_x_m], deceleration_lanes(road)
    left = []
    for own_x, flow in zip(entry_x, [mainline, *ramps], strict=True):
        comes = jnp.where(own_x <= x, flow, 0.0)
        for index in range(road.exit_x_m.shape[0]):
            stays = 1.0 - _share_leaving_at(index, own_x, demand, road)
            comes = jnp.where(x > leave_x[index], block_fma(comes * stays), comes)
        left.append(comes)
    return entry_x, left


def draw_origins(
    uniform: jax.Array, x: jax.Array, demand: DemandParams, road: RoadParams
) -> jax.Array:
    """Draws where vehicles entered that a reset puts at these positions, m.

    The chance of an entry is in proportion to the flow from it that still passes the position.

    Args:
      uniform: in [0, 1), one draw per vehicle; x: m, same shape.
    """
    entry_x, left = flows_past(x, demand, road)
    draw, below, entry = uniform * sum(left), left[0], jnp.zeros_like(x)
    for own_x, comes in zip(entry_x[1:], left[1:], strict=True):
        entry = jnp.where((draw >= below) & (own_x <= x), own_x, entry)
        below = below + comes
    return entry


def _lanes_to_go(vehicles: Vehicles, config: EnvConfig) -> jax.Array:
    """Lane changes to the rightmost lane, `(N,)` int32."""
    return jnp.maximum(config.num_lanes - 1 - vehicles.lane, 0)


def _distance_to_deceleration_lane(
    vehicles: Vehicles, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """Distance to the deceleration lane of each vehicle's exit, `(N,)` m; inf for those bound for the road's end."""
    bound = vehicles.destination < params.road.length_m
    return jnp.where(bound, vehicles.destination - params.road.exit_lane_m - vehicles.x, jnp.inf)


def exit_desire(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """How urgently each vehicle must go right for its exit, `(N,)` in 0 to 1.

    Source: the spatial route incentive of LMRS (Schakel, Knoop, van Arem 2012), 1 - x / (n x0), n lanes to go.
    """
    lanes = _lanes_to_go(vehicles, config)
    view = jnp.maximum(lanes, 1) * params.lane_change.exit_view_m
    # Finite, for gradients.
    distance = jnp.minimum(_distance_to_deceleration_lane(vehicles, config, params), view)
    desire = jnp.clip(1.0 - distance / view, 0.0, 1.0)
    return jnp.where((lanes > 0) & (vehicles.lane < config.num_lanes), desire, 0.0)


def distance_to_exit_preparation(
    vehicles: Vehicles, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """Distance to where each vehicle must prepare for its exit, `(N,)` m; inf for those bound for the road's end.

    Beyond that point there is no room for one more lane change. The distance is negative there.
    """
    view = (_lanes_to_go(vehicles, config) + 1) * params.lane_change.exit_view_m
    return _distance_to_deceleration_lane(vehicles, config, params) - view


def is_preparing_exit(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Whether each vehicle prepares for its exit now and does nothing else, `(N,)` bool."""
    return distance_to_exit_preparation(vehicles, config, params) < 0.0


def takes_exit(vehicles: Vehicles, config: EnvConfig, params: EnvParams) -> jax.Array:
    """Whether each vehicle leaves the road now, `(N,)` bool: settled in the rightmost lane, beside its exit lane."""
    distance = _distance_to_deceleration_lane(vehicles, config, params)
    along = (distance <= 0.0) & (distance >= -params.road.exit_lane_m)
    settled = jnp.abs(vehicles.lateral_offset) < 0.25 * params.road.lane_width_m
    return vehicles.active & along & settled & (vehicles.lane == config.num_lanes - 1)


def has_missed_exit(vehicles: Vehicles, road: RoadParams) -> jax.Array:
    """Whether each vehicle has driven past its exit, `(N,)` bool."""
    past = (vehicles.destination < road.length_m) & (vehicles.x > vehicles.destination)
    return vehicles.active & past
