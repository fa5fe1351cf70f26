"""Gaps and speeds for vehicles that enter the road."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from medjax.errors import former_names
from medjax.traffic.demand import Entries
from medjax.traffic.safety import BrakingLimits, can_follow_safely, safe_speed
from medjax.world.params import Scalar

# A vehicle may enter faster than its leader by its spare room divided by this.
CATCH_UP_S = 4.0
__getattr__ = former_names(__name__, cut_off="would_cut_off")


class Ahead(NamedTuple):
    """The next vehicle ahead of each entry, `(K,)` each."""

    gap: jax.Array  # m to its rear bumper, inf for none
    speed: jax.Array  # m/s, 0 for none


def next_ahead(
    where: Entries,
    x: jax.Array,
    lane: jax.Array,
    other: jax.Array,
    length: jax.Array,
    speed: jax.Array,
    active: jax.Array,
) -> Ahead:
    """Gap and speed of the next vehicle ahead of each entry, in its lane.

    Args:
      where: (K,) each; x, lane, length, speed, active: (N,) each.
      other: (N,) int32, the second lane of straddling vehicles (`medjax.traffic.road.straddled_lane`).
    """
    rear = x - length
    # A vehicle whose rear has not cleared the entry still blocks it.
    covers = (lane == where.lane[:, None]) | (other == where.lane[:, None])
    blocks = active & covers & (x >= where.x[:, None])
    gaps = jnp.where(blocks, rear - where.x[:, None], jnp.inf)
    gap = gaps.min(axis=1)
    # Two plain minima cost a fifth of one argmin on a CPU.
    is_nearest = blocks & (gaps == gap[:, None])
    slowest = jnp.min(jnp.where(is_nearest, speed, jnp.inf), axis=1)
    return Ahead(gap, jnp.where(jnp.isfinite(gap), slowest, 0.0))


def would_cut_off(
    where: Entries,
    length: jax.Array,
    x: jax.Array,
    other: jax.Array,
    speed: jax.Array,
    max_acceleration: jax.Array,
    limits: BrakingLimits,
) -> jax.Array:
    """Whether a newcomer would cut off an upstream vehicle that straddles the entry's lane, `(K,)` bool.

    That vehicle is leaving the acceleration lane upstream of the entry, and could not stop for the newcomer.

    Args:
      where: (K,) each; length: (K,) m, of the newcomers.
      x, speed, max_acceleration: (N,) m, m/s, highest acceleration m/s^2.
      other: (N,) int32, as in `next_ahead`; NO_LANE for inactive slots.
    """
    rear = where.x - length
    comes = (other == where.lane[:, None]) & (x < where.x[:, None])
    stops = can_follow_safely(
        speed, max_acceleration, rear[:, None] - x, jnp.zeros((), jnp.float32), limits
    )
    return (comes & ~stops).any(axis=1)


def entry_speed(
    wanted: jax.Array,
    ahead: Ahead,
    time_headway: jax.Array,
    min_gap: jax.Array,
    braking: Scalar,
) -> tuple[jax.Array, jax.Array]:
    """The speed at which a vehicle can enter, and whether it may.

    It enters with at least its own safe gap, no faster than its headway allows, at most a little faster than its
    leader, and so that it can stop behind its leader.

    Args:
      wanted: (K,) m/s.
      ahead: of each.
      time_headway: (K,) s; min_gap: (K,) m.
      braking: m/s^2, limit of the tyres.

    Returns:
      (speed m/s, safe bool), each (K,).
    """
    spare = jnp.maximum(ahead.gap - min_gap - time_headway * ahead.speed, 0.0)
    speed = jnp.where(
        jnp.isfinite(ahead.gap), jnp.minimum(wanted, ahead.speed + spare / CATCH_UP_S), wanted
    )
    speed = jnp.minimum(speed, safe_speed(ahead.gap, ahead.speed, braking))
    return speed, ahead.gap >= min_gap + time_headway * speed
