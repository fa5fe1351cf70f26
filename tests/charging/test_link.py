"""Coil geometry, efficiency and power of a docked pair, from first principles."""

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.charging.link import COUPLINGS, Misalignment, max_power, misalignment
from medjax.physics import link_efficiency, mutual_inductance
from medjax.world.params import FRONT, LEFT, REAR, RIGHT

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.parametrize("form", ["circuit", "paper"])
@pytest.mark.parametrize("lateral", [0.0, 0.1, 0.3])
def test_efficiency_is_that_of_the_coil_integral(paper, lateral, form):
    """The simulator's table agrees with the integral, in either form of eq (6)."""
    _, params = paper
    seen = COUPLINGS[form](Misalignment(jnp.float32(0.21), jnp.float32(lateral), 0.05), params.link)
    inductance = mutual_inductance(
        0.35, 0.30, 0.21, lateral, 0.05, primary_turns=10, secondary_turns=10
    )
    exact = link_efficiency(
        inductance,
        load=10.0,
        primary_resistance=0.159,
        secondary_resistance=0.126,
        angular_frequency=2 * np.pi * 85e3,
        form=form,
    )
    assert float(seen.efficiency) == pytest.approx(float(exact), abs=1e-3)


@pytest.mark.parametrize("form", ["circuit", "paper"])
def test_the_coil_s_current_limits_the_power(paper, form):
    """A slot sends its 40 kW at nominal alignment, less once 70 A limit it, and next to nothing where coils do not
    couple, as the solved circuit says."""
    _, params = paper
    link, slot = params.link, float(params.charging.slot_power_w)
    lateral = np.array([0.0, 0.2, 0.3, 0.4, 0.5, 0.58], np.float32)
    seen = COUPLINGS[form](Misalignment(jnp.float32(0.2), jnp.asarray(lateral), 0.0), link)
    power = np.asarray(max_power(seen, slot, link.max_current_a), np.float64)
    inductance = mutual_inductance(
        0.35, 0.30, 0.2, lateral, 0.0, primary_turns=10, secondary_turns=10
    )
    exact = np.array([sent_at(70.0, m) for m in np.asarray(inductance, np.float64)])
    np.testing.assert_allclose(power, np.minimum(slot, exact), rtol=0.01, atol=20.0)
    assert power[0] == power[1] == slot
    assert (np.diff(power[1:]) < 0).all()
    assert 20e3 < power[2] < 30e3
    assert power[-1] < 1e3


def sent_at(current, m, omega=2 * np.pi * 85e3):
    """Power into two resonant loops, W, at this RMS current in the primary, by Kirchhoff's laws."""
    secondary = 1j * omega * m * current / (0.126 + 10.0)
    voltage = 0.159 * current - 1j * omega * m * secondary
    return (voltage * np.conj(current)).real


def test_permeability_scales_the_inductance(paper):
    """Twice mu is twice M: the resistance that the inverter sees is the coil's own and four times the rest."""
    _, params = paper
    where = Misalignment(jnp.float32(0.25), jnp.array([0.0, 0.2]), 0.0)
    air = COUPLINGS["circuit"](where, params.link)
    twice = COUPLINGS["circuit"](where, params.link.replace(permeability=jnp.float32(2.0)))
    own = float(params.link.med_resistance_ohm)
    np.testing.assert_allclose(twice.input_ohm - own, 4.0 * (air.input_ohm - own), rtol=1e-5)
    assert (twice.efficiency > air.efficiency).all()


NORMALS = {LEFT: (0, -1, 0), RIGHT: (0, 1, 0), REAR: (-1, 0, 0), FRONT: (1, 0, 0)}


@pytest.mark.parametrize("charging_slot", [LEFT, RIGHT, REAR, FRONT])
def test_misalignment_geometry(charging_slot):
    """Axial and lateral distance are projections on the panel's normal and its plane; forward is x, right is y."""
    rng, normal = np.random.default_rng(charging_slot), np.array(NORMALS[charging_slot][:2], float)
    along, across, turn = rng.uniform(-0.1, 0.1, (3, 20))
    seen = misalignment(jnp.int32(charging_slot), along, across, turn, 0.2)
    offset = 0.2 * normal + np.stack([along, across], axis=1)
    np.testing.assert_allclose(seen.axial, offset @ normal, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(seen.lateral, offset @ np.abs(normal[::-1]), rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(np.abs(seen.tilt), np.abs(turn), rtol=1e-5)


@pytest.mark.parametrize("charging_slot", [LEFT, RIGHT, REAR, FRONT])
def test_tilt_sign_moves_the_near_edge(charging_slot):
    """The tilt's sign matches two real loops in space: Neumann's double integral in NumPy."""
    along, across, turn, gap = 0.05, 0.12, 0.2, 0.35
    if charging_slot in (REAR, FRONT):
        along, across = across, along
    seen = misalignment(jnp.int32(charging_slot), along, across, turn, gap)
    ours = mutual_inductance(0.35, 0.30, seen.axial, seen.lateral, seen.tilt)
    assert float(ours) == pytest.approx(neumann(charging_slot, along, across, turn, gap), rel=2e-3)


def neumann(charging_slot, along, across, turn, gap):
    """Mutual inductance of the two panels' loops, by Neumann's formula on 400 x 400 chords."""
    normal, up = np.array(NORMALS[charging_slot], float), np.array([0.0, 0.0, 1.0])
    side = np.cross(up, normal)
    angle = np.linspace(0.0, 2.0 * np.pi, 401)
    ring = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
    primary = 0.35 * ring
    # Heading turns to the right: forward (1, 0) goes to (cos, sin) with y to the right.
    cos, sin = np.cos(turn), np.sin(turn)
    rotate = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    secondary = gap * normal + np.array([along, across, 0.0]) + 0.30 * ring @ rotate.T
    first, second = np.diff(primary, axis=0), np.diff(secondary, axis=0)
    middle_1, middle_2 = (primary[1:] + primary[:-1]) / 2, (secondary[1:] + secondary[:-1]) / 2
    distance = np.linalg.norm(middle_1[:, None] - middle_2[None], axis=-1)
    return 1e-7 * np.sum(first @ second.T / distance)
