"""Mutual inductance from a table over the relative position of two coils."""

import itertools

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike

from medjax.physics._arrays import as_floats
from medjax.physics.coil import mutual_inductance


@struct.dataclass
class InductanceTable:
    """M of one coil pair on a grid that is even in log(axial), lateral and tilt.

    Every field is a leaf, so that `jax.vmap` runs over coil designs. The grid starts at
    lateral = 0; M(-lateral, -tilt) = M(lateral, tilt) gives the other side.
    """

    values: jax.Array  # (num_axial, num_lateral, num_tilt) H
    log_axial_origin: jax.Array  # () log(m), the shortest axial distance
    log_axial_step: jax.Array  # () log(m)
    lateral_step: jax.Array  # () m
    tilt_origin: jax.Array  # () rad, the most negative tilt
    tilt_step: jax.Array  # () rad


def tabulate_inductance(
    primary_radius: ArrayLike,
    secondary_radius: ArrayLike,
    *,
    primary_turns: ArrayLike = 1,
    secondary_turns: ArrayLike = 1,
    min_axial: ArrayLike = 0.05,
    max_axial: ArrayLike = 1.0,
    max_lateral: ArrayLike = 1.2,
    max_tilt: ArrayLike = 0.3,
    num_axial: int = 40,
    num_lateral: int = 96,
    num_tilt: int = 17,
) -> InductanceTable:
    """Tabulates `mutual_inductance` of one coil pair; pure and jittable, with static grid sizes."""
    for name, size in (
        ("num_axial", num_axial),
        ("num_lateral", num_lateral),
        ("num_tilt", num_tilt),
    ):
        if size < 2:
            raise ValueError(f"{name} is {size}, must be at least 2")
    low, high, lateral_limit, tilt_limit = as_floats(min_axial, max_axial, max_lateral, max_tilt)
    log_low, log_high = jnp.log(low), jnp.log(high)
    axial = jnp.exp(jnp.linspace(log_low, log_high, num_axial))
    lateral = jnp.linspace(0.0, lateral_limit, num_lateral)
    tilt = jnp.linspace(-tilt_limit, tilt_limit, num_tilt)
    values = mutual_inductance(
        primary_radius,
        secondary_radius,
        axial[:, None, None],
        lateral[:, None],
        tilt,
        primary_turns=primary_turns,
        secondary_turns=secondary_turns,
    )
    return InductanceTable(
        values=values,
        log_axial_origin=log_low,
        log_axial_step=(log_high - log_low) / (num_axial - 1),
        lateral_step=lateral_limit / (num_lateral - 1),
        tilt_origin=-tilt_limit,
        tilt_step=2 * tilt_limit / (num_tilt - 1),
    )


def interpolate_inductance(
    table: InductanceTable, axial: ArrayLike, lateral: ArrayLike, tilt: ArrayLike
) -> jax.Array:
    """M of the tabulated pair at a position, trilinear between the table's points, H."""
    axial, lateral, tilt = as_floats(axial, lateral, tilt)
    # Only one side is stored; turned by half a circle about the axis the other side is the same.
    tilt = jnp.where(lateral < 0, -tilt, tilt)
    lowest_axial = jnp.exp(table.log_axial_origin)
    axes = (
        (jnp.log(jnp.maximum(axial, lowest_axial)) - table.log_axial_origin) / table.log_axial_step,
        jnp.abs(lateral) / table.lateral_step,
        (tilt - table.tilt_origin) / table.tilt_step,
    )
    corner, fractions = [], []
    for position, size in zip(axes, table.values.shape, strict=True):
        position = jnp.clip(position, 0, size - 1)
        cell = jnp.minimum(position.astype(jnp.int32), size - 2)
        corner.append(cell)
        fractions.append(position - cell)
    _, num_lateral, num_tilt = table.values.shape
    first = (corner[0] * num_lateral + corner[1]) * num_tilt + corner[2]
    strides = (num_lateral * num_tilt, num_tilt, 1)
    flat = table.values.reshape(-1)
    total = jnp.zeros((), table.values.dtype)
    for ends in itertools.product((0, 1), repeat=3):
        index = first + sum(end * stride for end, stride in zip(ends, strides, strict=True))
        weight = jnp.ones((), table.values.dtype)
        for end, fraction in zip(ends, fractions, strict=True):
            weight = weight * (fraction if end else 1 - fraction)
        total = total + weight * flat[index]
    return total
