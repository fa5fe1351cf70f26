"""MOBIL: when a lane change is worth it and when it is safe (Kesting, Treiber, Helbing 2007)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


def mobil_incentive(
    own_before: ArrayLike,
    own_after: ArrayLike,
    old_follower_before: ArrayLike,
    old_follower_after: ArrayLike,
    new_follower_before: ArrayLike,
    new_follower_after: ArrayLike,
    *,
    politeness: ArrayLike,
) -> jax.Array:
    """What a change gains, before the threshold: own gain plus politeness times the others' gain.

    Args:
      own_before, own_after: acceleration of the changing vehicle in its lane and in the target
        lane, m/s^2; all arguments broadcast together.
      old_follower_before, old_follower_after: of the vehicle now behind, with and without the
        changing one ahead of it. Pass equal values where there is none.
      new_follower_before, new_follower_after: of the vehicle then behind, likewise.
      politeness: p, weight of the others; 0 is selfish.

    Returns:
      (a~c - a_c) + p [(a~o - a_o) + (a~n - a_n)], m/s^2; compare it with a threshold.

    Source: MOBIL, eq (3); each follower's accelerations are its own, with its own parameters.
    """
    others = jnp.subtract(old_follower_after, old_follower_before)
    others = others + jnp.subtract(new_follower_after, new_follower_before)
    return jnp.subtract(own_after, own_before) + politeness * others


def is_safe(
    own_after: ArrayLike,
    new_follower_after: ArrayLike,
    gap_ahead: ArrayLike,
    gap_behind: ArrayLike,
    *,
    safe_braking: ArrayLike,
    min_gap_ahead: ArrayLike,
    min_gap_behind: ArrayLike,
) -> jax.Array:
    """Whether a change forces nobody to brake harder than safe_braking and leaves room on both sides.

    Args:
      own_after, new_follower_after: accelerations after the change, m/s^2.
      gap_ahead, gap_behind: bumper gaps in the target lane, m.
      safe_braking: b_safe, m/s^2, positive.
      min_gap_ahead, min_gap_behind: standing gaps of the two followers concerned, m.

    Returns:
      bool, broadcast. MOBIL asks it of the new follower, eq (2); here the changing vehicle asks the
      same of itself, or it would have to brake as hard as it spares the other.
    """
    braking = jnp.minimum(own_after, new_follower_after) >= jnp.negative(safe_braking)
    room = jnp.greater_equal(gap_ahead, min_gap_ahead)
    return braking & room & jnp.greater_equal(gap_behind, min_gap_behind)
