"""MOBIL: incentive and safety of a lane change (Kesting, Treiber, Helbing 2007)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from medjax.numerics.shapes import Floats, Numbers


def mobil_incentive(
    own_before: Numbers,
    own_after: Numbers,
    old_follower_before: Numbers,
    old_follower_after: Numbers,
    new_follower_before: Numbers,
    new_follower_after: Numbers,
    *,
    politeness: Numbers,
) -> Floats:
    """Incentive of a lane change: own gain plus politeness times the others' gain.

    Args:
      own_before, own_after: acceleration of the changing vehicle in its lane and in the target lane, m/s^2; all
        arguments broadcast together.
      old_follower_before, old_follower_after: of the current follower, before and after the change. Pass equal
        values where there is none.
      new_follower_before, new_follower_after: of the follower in the target lane, likewise.
      politeness: p, weight of the others; 0 is selfish.

    Returns:
      (a~c - a_c) + p [(a~o - a_o) + (a~n - a_n)], m/s^2; compare it with a threshold.

    Source: MOBIL, eq (3); each follower's accelerations follow from its own parameters.
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
    """Whether a change makes nobody brake harder than safe_braking and leaves room ahead and behind.

    Args:
      own_after, new_follower_after: accelerations after the change, m/s^2.
      gap_ahead, gap_behind: bumper gaps in the target lane, m.
      safe_braking: b_safe, m/s^2, positive.
      min_gap_ahead, min_gap_behind: standing gaps of the two followers concerned, m.

    Returns:
      bool, broadcast. MOBIL limits the braking of the new follower, eq (2). Here the same limit also holds for the
      changing vehicle.
    """
    braking = jnp.minimum(own_after, new_follower_after) >= jnp.negative(safe_braking)
    room = jnp.greater_equal(gap_ahead, min_gap_ahead)
    return braking & room & jnp.greater_equal(gap_behind, min_gap_behind)
