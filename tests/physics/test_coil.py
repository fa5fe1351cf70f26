"""Mutual inductance, against the reference integrals, closed forms and symmetries."""

import functools
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from medjax.physics import VACUUM_PERMEABILITY, mutual_inductance

ROWS = np.genfromtxt(
    Path(__file__).parents[1] / "data" / "mutual_inductance.csv",
    delimiter=",",
    names=True,
    dtype=None,
    encoding="utf-8",
)
POSITIONS = [
    ROWS[name] for name in ("r_primary_m", "r_secondary_m", "axial_m", "lateral_m", "tilt_rad")
]
EXPECTED = ROWS["mutual_inductance_H"]
GAP = ROWS["min_wire_gap_m"]
exact = jax.jit(lambda *position: mutual_inductance(*position, num_nodes=256, num_agm_steps=6))

# Positions whose wires stay apart whatever the tilt: 0.3 sin(0.6) < 0.2.
POSITION = (
    st.floats(0.1, 0.4),
    st.floats(0.1, 0.3),
    st.floats(0.25, 1.5),
    st.floats(-1.2, 1.2),
    st.floats(-0.6, 0.6),
)


def coaxial(radius_1, radius_2, axial):
    """Maxwell's closed form, DLMF 19.34, in float64 SciPy."""
    m = 4 * radius_1 * radius_2 / ((radius_1 + radius_2) ** 2 + axial**2)
    k = np.sqrt(m)
    psi = (2 / k - k) * special.ellipk(m) - 2 / k * special.ellipe(m)
    return 4e-7 * np.pi * np.sqrt(radius_1 * radius_2) * psi


PEAK = coaxial(*POSITIONS[:3])


@pytest.mark.versions
def test_all_rows_in_float64():
    with jax.enable_x64(True):
        value = np.asarray(exact(*POSITIONS))
    assert value.dtype == np.float64
    assert len(value) == 400
    np.testing.assert_allclose(value, EXPECTED, rtol=1e-8)


@pytest.mark.parametrize(
    ("num_nodes", "least_gap"), [(48, 0.05), (32, 0.1), (256, 0.0)], ids=["default", "32", "256"]
)
def test_rows_in_float32(num_nodes, least_gap):
    # Half a rim of 48 points resolves wires that are 0.05 m apart or more; the 27 rows nearer
    # need more points, in any precision.
    use = least_gap <= GAP
    assert np.count_nonzero(use) >= {48: 373, 32: 300, 256: 400}[num_nodes]
    rows = [x[use].astype(np.float32) for x in POSITIONS]
    compute = jax.jit(functools.partial(mutual_inductance, num_nodes=num_nodes))
    value = np.asarray(compute(*rows))
    assert value.dtype == np.float32
    error = np.abs(value.astype(np.float64) - EXPECTED[use])
    assert np.all(error <= 1e-5 * np.abs(EXPECTED[use]) + 1e-6 * PEAK[use])


def test_literal_values():
    """Of reference/README.md, with the vacuum permeability among them."""
    with jax.enable_x64(True):
        args = (0.3, 0.2, 0.15, 0.1, np.array([0.3, -0.3]))
        ratio = np.asarray(exact(*args)) / (4e-7 * np.pi)
        np.testing.assert_allclose(ratio, [0.119364432552, 0.146361502905], rtol=1e-11)
        np.testing.assert_allclose(
            exact(0.3, 0.3, 0.2, 0.0, 0.0), 2.4890191325645735e-7, rtol=1e-12
        )
    assert pytest.approx(1.25663706143592e-6, rel=1e-14) == VACUUM_PERMEABILITY


@settings(max_examples=60)
@given(*POSITION[:2], st.floats(0.05, 3.0))
def test_coaxial_rings_have_maxwells_value_either_way_round(radius_1, radius_2, axial):
    with jax.enable_x64(True):
        forth = float(exact(radius_1, radius_2, axial, 0.0, 0.0))
        back = float(exact(radius_2, radius_1, axial, 0.0, 0.0))
    # The closed form cancels where k is small; 1e-10 is what is left of its float64 there.
    assert forth == pytest.approx(coaxial(radius_1, radius_2, axial), rel=1e-10)
    assert back == pytest.approx(forth, rel=1e-12)


@settings(max_examples=60)
@given(*POSITION)
def test_symmetries(radius_1, radius_2, axial, lateral, tilt):
    """M stays the same turned over, seen from below and scaled, and for parallel coils exchanged."""
    with jax.enable_x64(True):
        value = float(exact(radius_1, radius_2, axial, lateral, tilt))
        turned = float(exact(radius_1, radius_2, axial, -lateral, -tilt))
        below = float(exact(radius_1, radius_2, -axial, lateral, -tilt))
        scaled = float(exact(10 * radius_1, 10 * radius_2, 10 * axial, 10 * lateral, tilt) / 10)
        forth = float(exact(radius_1, radius_2, axial, lateral, 0.0))
        back = float(exact(radius_2, radius_1, axial, lateral, 0.0))
    tolerance = 1e-13 * coaxial(radius_1, radius_2, axial)
    assert [turned, below, scaled] == pytest.approx([value] * 3, abs=tolerance)
    assert back == pytest.approx(forth, abs=tolerance)


def test_far_coils_are_dipoles():
    # M = mu0 A1 A2 / (4 pi r^3) (3 (n1 r)(n2 r) - n1 n2), r a unit vector; next order (R/r)^2.
    radius_1, radius_2, distance = 0.02, 0.03, 20.0
    bearing, tilt = np.meshgrid(np.linspace(-1.5, 1.5, 7), np.linspace(-1.0, 1.0, 5))
    lateral, axial = distance * np.sin(bearing), distance * np.cos(bearing)
    along_2 = -np.sin(tilt) * np.sin(bearing) + np.cos(tilt) * np.cos(bearing)
    angles = 3 * np.cos(bearing) * along_2 - np.cos(tilt)
    scale = 1e-7 * (np.pi * radius_1**2) * (np.pi * radius_2**2) / distance**3
    with jax.enable_x64(True):
        value = np.asarray(exact(radius_1, radius_2, axial, lateral, tilt))
    np.testing.assert_allclose(value, scale * angles, atol=2e-5 * scale)


def test_turns_multiply():
    one = float(mutual_inductance(0.35, 0.3, 0.2, 0.1, 0.05))
    many = mutual_inductance(0.35, 0.3, 0.2, 0.1, 0.05, primary_turns=10, secondary_turns=7)
    assert float(many) == pytest.approx(70 * one, rel=1e-6)


def test_gradients_match_finite_differences():
    """For each of the five arguments."""
    gradient = jax.jit(jax.vmap(jax.grad(exact, argnums=(0, 1, 2, 3, 4))))
    # M changes over the distance of the wires; with a step of 1/500 of it the five-point formula
    # is off by some 500^-4 = 2e-11, rounding by some 500 * 1e-15.
    step, scale = 0.002 * GAP, PEAK / GAP
    with jax.enable_x64(True):
        gradients = gradient(*POSITIONS)
        for argument, ours in enumerate(gradients):

            def shifted(steps, argument=argument):
                moved = list(POSITIONS)
                moved[argument] = moved[argument] + steps * step
                return np.asarray(exact(*moved))

            slope = (8 * (shifted(1) - shifted(-1)) - (shifted(2) - shifted(-2))) / (12 * step)
            assert np.all(np.isfinite(ours))
            np.testing.assert_allclose(ours / scale, slope / scale, rtol=1e-8, atol=1e-9)


def test_float32_gradients_are_finite_and_right():
    rows32 = [x.astype(np.float32) for x in POSITIONS]
    argnums = (0, 1, 2, 3, 4)
    default = jax.jit(jax.vmap(jax.grad(mutual_inductance, argnums=argnums)))
    with jax.enable_x64(True):
        reference = [np.asarray(g) for g in default(*POSITIONS)]
    for ours, wanted in zip(default(*rows32), reference, strict=True):
        assert ours.dtype == np.float32
        assert np.all(np.isfinite(ours))
        np.testing.assert_allclose(ours * GAP / PEAK, wanted * GAP / PEAK, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("lateral", [0.0, 0.3])
@pytest.mark.parametrize("secondary_radius", [0.3, 0.2])
def test_aligned_coils_have_a_finite_gradient(lateral, secondary_radius):
    # lateral = secondary_radius is the printed form's 0 / 0.
    gradient = jax.jit(jax.grad(mutual_inductance, argnums=(2, 3, 4)))(
        0.3, secondary_radius, 0.2, lateral, 0.0
    )
    assert np.all(np.isfinite(gradient))
    if lateral == 0.0:
        np.testing.assert_allclose(gradient[1:], 0.0, atol=1e-13)


def test_sign_changes_past_the_rim():
    # reference/README.md: a null at lateral 0.577 m for axial 0.2 m with radii 0.35 and 0.30 m.
    value = mutual_inductance(0.35, 0.30, 0.2, np.array([0.5765, 0.5775]), 0.0)
    assert float(value[0]) > 0 > float(value[1])


@pytest.mark.thorough
@pytest.mark.versions
def test_broadcasting_jit_and_vmap_agree():
    axial = np.array([[0.1], [0.2], [0.4]], np.float32)
    lateral = np.array([0.0, 0.1, 0.3, 0.6], np.float32)
    args = (0.35, 0.3, axial, lateral, 0.1)
    value = mutual_inductance(*args)
    assert value.shape == (3, 4)
    assert not value.weak_type
    over_lateral = jax.vmap(mutual_inductance, (None, None, None, 0, None))
    over_both = jax.vmap(over_lateral, (None, None, 0, None, None))
    by_vmap = over_both(0.35, 0.3, axial[:, 0], lateral, 0.1)
    np.testing.assert_allclose(jax.jit(mutual_inductance)(*args), value, rtol=1e-5)
    np.testing.assert_allclose(by_vmap, value, rtol=1e-5)


def test_too_few_nodes_are_refused():
    with pytest.raises(ValueError, match="num_nodes is 1, must be at least 2"):
        mutual_inductance(0.3, 0.3, 0.2, 0.0, 0.0, num_nodes=1)
