"""How a steady flow spreads over a road: where a reset puts vehicles."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma
from medjax.traffic.exits import deceleration_lanes, flows_past
from medjax.world.params import DemandParams, RoadParams


class Sections(NamedTuple):
    """Sections of the road between two ramps or exits, in which the flow is the same all along; `(K,)` but for two."""

    length: jax.Array  # m
    before: jax.Array  # flow times way upstream of it, in proportion to the vehicles there
    within: jax.Array  # flow times way in it
    total: jax.Array  # () flow times way on the whole road
    evenness: jax.Array  # () the mean density over the highest one, at most 1


def sections_of(demand: DemandParams, road: RoadParams) -> Sections:
    """How a steady flow at the rates of the episode's start spreads over the road, as every kind does at its speed."""
    start, end = jnp.zeros((1,), jnp.float32), jnp.reshape(jnp.float32(road.length_m), (1,))
    ends = jnp.sort(jnp.concatenate([start, road.ramp_x_m, deceleration_lanes(road), end]))
    length = jnp.diff(ends)
    flow = sum(flows_past(ends[:-1] + 0.5 * length, demand, road)[1])
    within = block_fma(flow * length)
    # Sums in a fixed order, so that an environment alone and one of many have the same bits.
    before = [jnp.zeros((), jnp.float32)]
    for each in within:
        before.append(before[-1] + each)
    total = jnp.maximum(before[-1], 1e-6)  # a road without demand stays empty
    most = jnp.maximum(jnp.max(jnp.where(length > 0.0, flow, 0.0)), 1e-6)
    evenness = total / (most * road.length_m)
    return Sections(length, jnp.stack(before[:-1]), within, total, evenness)


def place(share: jax.Array, sections: Sections) -> jax.Array:
    """Where this share of all vehicles is upstream, m, in 0 to 1 of any shape."""
    x, so_far = jnp.zeros_like(share), block_fma(share * sections.total)
    # XLA multiplies by the reciprocal of what environments share; this does so for one environment, too.
    per_vehicle = 1.0 / jnp.maximum(sections.within, 1e-6)
    for length, before, each in zip(sections.length, sections.before, per_vehicle, strict=True):
        passed = (so_far - before) * each
        x += block_fma(length * jnp.clip(passed, 0.0, 1.0))
    return x
