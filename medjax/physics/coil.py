"""Mutual inductance of two circular coils with lateral offset and tilt."""

import math

import jax.numpy as jnp
import numpy as np

from medjax.errors import InputError
from medjax.numerics.shapes import Floats, Numbers
from medjax.physics._arrays import as_floats
from medjax.physics.elliptic import psi_sum

VACUUM_PERMEABILITY = 4e-7 * math.pi  # mu0, H/m


def mutual_inductance(
    primary_radius: Numbers,
    secondary_radius: Numbers,
    axial: Numbers,
    lateral: Numbers,
    tilt: Numbers,
    *,
    primary_turns: Numbers = 1,
    secondary_turns: Numbers = 1,
    num_nodes: int = 48,
    num_agm_steps: int = 4,
) -> Floats:
    """Mutual inductance of two circular filament coils in air, by the paper's eqs (1)-(5).

    The primary lies in z = 0, centred on the origin. The secondary's centre is (lateral, 0, axial) and its normal
    (-sin(tilt), 0, cos(tilt)): for positive lateral, axial and tilt, the rim nearest the primary's axis dips toward
    the primary. The sign is that of the flux, so it changes where the secondary slides off the primary (the null).
    M(lateral, tilt) = M(-lateral, -tilt), and M(axial, tilt) = M(-axial, -tilt).

    All arguments broadcast to the shape of the result, `(...)`. It is differentiable except where the wires touch.

    Args:
      primary_radius, secondary_radius: m, positive; in the paper R_MED and R_EV.
      axial, lateral: distance of the centres along (c) and across (d) the primary's axis, m.
      tilt: angle between the two axes (theta), rad.
      primary_turns, secondary_turns: numbers of turns, concentrated in one filament per side.
      num_nodes: points of the trapezoid rule over half the secondary's rim, at least 2.
      num_agm_steps: steps of the arithmetic-geometric mean at each point.

    Returns:
      M in henry, in the widest floating type among the arguments. For radii of some 0.3 m the default nodes and steps
      truncate less than 1e-6 of M's coaxial value while the wires are 0.05 m or more apart; 256 nodes leave float64's
      rounding down to 0.02 m.

    Raises:
      InputError: fewer than two nodes.

    Source: paper eqs (1)-(5), rewritten: the printed form subtracts nearly equal numbers in Psi(k), and is 0/0 where
    lateral = secondary_radius * cos(tilt).
    """
    if num_nodes < 2:
        raise InputError(f"num_nodes is {num_nodes}, must be at least 2")
    radius_1, radius_2, axial, lateral, tilt, turns_1, turns_2 = as_floats(
        primary_radius, secondary_radius, axial, lateral, tilt, primary_turns, secondary_turns
    )
    pose = radius_2 / radius_1, axial / radius_1, lateral / radius_2, jnp.sin(tilt), jnp.cos(tilt)
    # phi along the secondary's rim is a new last axis.
    alpha, beta, offset, sin_tilt, cos_tilt = (jnp.expand_dims(x, -1) for x in pose)
    cos_phi, sin_phi, weights = (jnp.asarray(x, radius_1.dtype) for x in _half_rim(num_nodes))

    # Distances of a rim point in primary radii: squared from the axis, and above the plane.
    axis_sq = alpha**2 * ((cos_phi * cos_tilt - offset) ** 2 + sin_phi**2)
    height = beta - alpha * cos_phi * sin_tilt
    # The means of eq (3)'s k after a first step. The root of (1 + axis_sq + height^2)^2 - 4 axis_sq would cancel.
    b_sq = jnp.sqrt((1 - axis_sq - height**2) ** 2 + 4 * height**2)
    a_sq = (1 + axis_sq + height**2 + b_sq) / 2
    sum_psi, a = psi_sum(a_sq, b_sq, axis_sq, num_agm_steps)
    integrand = (cos_tilt - offset * cos_phi) * sum_psi / a
    scale = (VACUUM_PERMEABILITY / 4) * turns_1 * turns_2 * radius_2**2 / radius_1
    return scale * jnp.sum(weights * integrand, axis=-1)


def _half_rim(num_nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """cos(phi), sin(phi) and weights of the nodes, `(num_nodes,)` each."""
    # The integrand is smooth and periodic in phi, for which no rule beats the trapezoid rule.
    phi = np.linspace(0.0, math.pi, num_nodes)
    spacing = np.full(num_nodes, math.pi / (num_nodes - 1))
    spacing[[0, -1]] /= 2
    return np.cos(phi), np.sin(phi), spacing
