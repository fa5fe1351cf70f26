"""How a steady flow spreads over a road: where a reset puts vehicles."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.numerics.sums import block_fma
from medjax.traffic.exits import flows_past
from medjax.world.params import DemandParams, RoadParams


class Sections(NamedTuple):
    """Sections of the road between two ramps or exits, in which the flow is the same all along; `(K,)` but for one."""

    length: jax.Array  # m
    before: jax.Array  # vehicles upstream of it, in steady flow, as a share of all
    vehicles: jax.Array  # vehicles in it, as a share of all
    evenness: jax.Array  # () the mean density over the highest one, at most 1


def sections_of(demand: DemandParams, road: RoadParams) -> Sections:
    """How a steady flow at the rates of the episode's start spreads over the road, as every kind does at its speed."""
    around = jnp.zeros((1,), jnp.float32), jnp.reshape(jnp.float32(road.length_m), (1,))
    ends = jnp.sort(jnp.concatenate([around[0], road.ramp_x_m, road.exit_x_m, around[1]]))
    length = jnp.diff(ends)
    flow = sum(flows_past(ends[:-1] + 0.5 * length, demand, road)[1])
    vehicles = flow * length
    total = jnp.maximum(jnp.sum(vehicles), 1e-6)  # a road without demand stays empty
    most = jnp.maximum(jnp.max(jnp.where(length > 0.0, flow, 0.0)), 1e-6)
    share = vehicles / total
    return Sections(length, jnp.cumsum(share) - share, share, total / (most * road.length_m))


def place(share: jax.Array, sections: Sections) -> jax.Array:
    """Where this share of all vehicles is upstream, m, in 0 to 1 of any shape."""
    x = jnp.zeros_like(share)
    for length, before, vehicles in zip(*sections[:3], strict=True):
        # Reciprocals of what environments share, as in `medjax.traffic.demand`.
        passed = (share - before) * (1.0 / jnp.maximum(vehicles, 1e-9))
        x += block_fma(length * jnp.clip(passed, 0.0, 1.0))
    return x
