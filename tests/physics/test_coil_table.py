"""The table of mutual inductance, against the integral it stands for."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.physics import (
    interpolate_inductance,
    link_efficiency,
    mutual_inductance,
    tabulate_inductance,
)

RADII = (0.35, 0.30)
TURNS = {"primary_turns": 10, "secondary_turns": 10}
LINK = {
    "load": 10.0,
    "primary_resistance": 0.159,
    "secondary_resistance": 0.126,
    "angular_frequency": 2 * np.pi * 85e3,
}
interpolate = jax.jit(interpolate_inductance)
integral = jax.jit(functools.partial(mutual_inductance, num_nodes=256))
exact = jax.jit(lambda *position: mutual_inductance(*RADII, *position, num_nodes=256, **TURNS))


@pytest.fixture(scope="module")
def table():
    return tabulate_inductance(*RADII, **TURNS)


def random_positions(count, nearest=0.05, farthest=1.0):
    """Positions all over the default limits, a half of them at short axial distances."""
    random = np.random.default_rng(20240607)
    near = random.uniform(nearest, 0.3, count // 2)
    axial = np.append(near, random.uniform(nearest, farthest, count - count // 2))
    return axial, random.uniform(-1.2, 1.2, count), random.uniform(-0.3, 0.3, count)


def wire_gap(axial, lateral, tilt):
    """Shortest distance between the two wires, m, from the geometry of reference/README.md."""
    phi = np.linspace(0, 2 * np.pi, 361)
    x = lateral[:, None] + RADII[1] * np.cos(phi) * np.cos(tilt)[:, None]
    y = RADII[1] * np.sin(phi)
    z = axial[:, None] + RADII[1] * np.cos(phi) * np.sin(tilt)[:, None]
    return np.min(np.hypot(np.hypot(x, y) - RADII[0], z), axis=1)


def test_efficiency_from_the_table_is_the_integrals(table):
    position = random_positions(20_000)
    ours = np.asarray(link_efficiency(interpolate(table, *map(np.float32, position)), **LINK))
    with jax.enable_x64(True):
        parts = zip(*(np.split(x, 10) for x in position), strict=True)
        true = np.concatenate([link_efficiency(exact(*part), **LINK) for part in parts])
    error = np.abs(ours - true)
    assert np.all(np.isfinite(ours))
    # Filaments that touch have no finite M; see the docstring of tabulate_inductance.
    apart = wire_gap(*position) >= 0.03
    assert np.mean(apart) > 0.99
    assert np.max(error[apart]) < 1e-3
    assert np.mean(error) < 1e-4
    assert np.quantile(error, 0.999) < 1e-3


def test_default_table_is_small_and_single(table):
    assert table.values.dtype == np.float32
    assert sum(leaf.nbytes for leaf in jax.tree.leaves(table)) < 256 * 1024
    assert all(not leaf.weak_type for leaf in jax.tree.leaves(table))


def test_sign_and_null_are_the_integrals(table):
    axial, lateral, tilt = random_positions(4000, nearest=0.15)
    with jax.enable_x64(True):
        true = np.asarray(exact(axial, lateral, tilt))
    ours = np.asarray(interpolate(table, *map(np.float32, (axial, lateral, tilt))))
    clear = np.abs(true) > 1e-8  # the null lies elsewhere by less than this, of some 3e-5
    np.testing.assert_array_equal(np.sign(ours[clear]), np.sign(true[clear]))
    assert true.min() < 0 < true.max()
    # reference/README.md: the null at axial 0.2 m is at lateral 0.577 m, on either side.
    inside, outside = interpolate(table, 0.2, np.float32([[0.575, -0.575], [0.579, -0.579]]), 0.0)
    assert np.all(inside > 0)
    assert np.all(outside < 0)


def test_the_other_side_is_turned_not_mirrored(table):
    positions = (0.2, np.float32([0.3, -0.3, 0.3, -0.3]), np.float32([0.2, -0.2, -0.2, 0.2]))
    value = np.asarray(interpolate(table, *positions))
    assert value[0] == value[1]
    assert value[2] == value[3]
    with jax.enable_x64(True):
        true = np.asarray(exact(0.2, 0.3, np.array([0.2, -0.2])))
    np.testing.assert_allclose(value[[0, 2]], true, rtol=1e-3)
    assert abs(true[0] / true[1] - 1) > 0.05


def test_positions_outside_count_as_the_limit(table):
    axial = np.float32([0.0, -1.0, 9.0, 0.2, 0.2, 0.2, 0.2])
    lateral = np.float32([0.0, 0.0, 0.0, 5.0, -5.0, 0.1, 0.1])
    tilt = np.float32([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, -2.0])
    outside = interpolate(table, axial, lateral, tilt)
    limit = interpolate(table, axial.clip(0.05, 1.0), lateral.clip(-1.2, 1.2), tilt.clip(-0.3, 0.3))
    np.testing.assert_allclose(outside, limit, rtol=1e-6)
    with jax.enable_x64(True):
        true = np.asarray(exact(np.array([0.05, 1.0]), 0.0, 0.0))
    np.testing.assert_allclose(np.asarray(outside)[[0, 2]], true, rtol=2e-3)


def test_custom_limits_and_grid():
    fine = tabulate_inductance(
        *RADII, **TURNS, min_axial=0.1, max_axial=0.4, max_lateral=0.5, max_tilt=0.1,
        num_axial=64, num_lateral=32, num_tilt=8,
    )  # fmt: skip
    assert fine.values.shape == (64, 32, 8)
    axial, lateral, tilt = np.float32([0.1, 0.25, 0.4]), 0.47, np.float32([-0.1, 0.03, 0.1])
    with jax.enable_x64(True):
        true = np.asarray(exact(axial.astype(float), lateral, tilt.astype(float)))
    np.testing.assert_allclose(interpolate(fine, axial, lateral, tilt), true, rtol=2e-4)


def test_vmap_over_coil_designs():
    primary = np.float32([0.25, 0.35, 0.45])
    turns = np.float32([6, 10, 14])
    tables = jax.vmap(lambda r, n: tabulate_inductance(r, 0.3, primary_turns=n))(primary, turns)
    position = (0.2, np.float32([0.0, 0.15, -0.3]), 0.1)
    value = jax.vmap(lambda t: interpolate(t, *position))(tables)
    assert value.shape == (3, 3)
    with jax.enable_x64(True):
        true = integral(
            primary[:, None].astype(float), 0.3, 0.2, position[1].astype(float), 0.1,
            primary_turns=turns[:, None],
        )  # fmt: skip
    np.testing.assert_allclose(value, true, rtol=2e-3)


def test_double_precision_tables():
    with jax.enable_x64(True):
        table = tabulate_inductance(np.float64(0.35), 0.3, num_axial=4, num_lateral=4, num_tilt=4)
        assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(table))
        value = interpolate(table, np.float64(0.05), 0.4, 0.1)
        assert value.dtype == np.float64
        # A point of the grid.
        true = jax.jit(mutual_inductance)(0.35, 0.3, 0.05, 0.4, 0.1)
        assert float(value) == pytest.approx(float(true), rel=1e-12)


def test_gradients_are_finite_and_point_along_the_integrals(table):
    axial, lateral, tilt = (jnp.float32(x) for x in (0.23, 0.31, 0.05))
    ours = jax.grad(interpolate, argnums=(1, 2, 3))(table, axial, lateral, tilt)
    with jax.enable_x64(True):
        true = jax.grad(exact, argnums=(0, 1, 2))(*map(np.float64, (axial, lateral, tilt)))
    np.testing.assert_allclose(ours, true, rtol=0.03)
    at_zero = jax.grad(interpolate, argnums=(1, 2, 3))(table, axial, 0.0, 0.0)
    assert np.all(np.isfinite(at_zero))


@pytest.mark.parametrize(("name", "least"), [("num_axial", 2), ("num_lateral", 4), ("num_tilt", 4)])
def test_too_small_a_grid_is_refused(name, least):
    with pytest.raises(ValueError, match=f"{name} is {least - 1}, must be at least {least}"):
        tabulate_inductance(*RADII, **{name: least - 1})
