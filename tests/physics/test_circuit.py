"""Link efficiency, against a circuit solved in complex numbers and numbers known beforehand."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.physics import input_resistance, link_efficiency, mutual_inductance

OMEGA = 2 * np.pi * 85e3
DEFAULTS = {
    "load": 10.0,
    "primary_resistance": 0.159,
    "secondary_resistance": 0.126,
    "angular_frequency": OMEGA,
}


def solved_circuit(m, inductance, *, load, primary_resistance, secondary_resistance, omega):
    """Two series-resonant loops at 1 V: power in the load over power from the source."""
    capacitance = 1 / (omega**2 * np.asarray(inductance))
    reactance = 1j * omega * np.asarray(inductance) + 1 / (1j * omega * capacitance)
    impedance = np.array(
        [
            [primary_resistance + reactance[0], -1j * omega * m],
            [-1j * omega * m, secondary_resistance + load + reactance[1]],
        ]
    )
    primary, secondary = np.linalg.solve(impedance, [1.0, 0.0])
    return load * abs(secondary) ** 2 / primary.real


@settings(max_examples=200)
@given(
    m=st.floats(1e-8, 1e-3),
    sign=st.sampled_from([-1, 1]),
    inductance=st.tuples(st.floats(1e-6, 1e-3), st.floats(1e-6, 1e-3)),
    load=st.floats(0.1, 1e3),
    primary_resistance=st.floats(1e-3, 10.0),
    secondary_resistance=st.floats(0.0, 10.0),
    omega=st.floats(1e4, 1e7),
)
def test_circuit_form_is_the_solved_circuit(
    m, sign, inductance, load, primary_resistance, secondary_resistance, omega
):
    resistances = {
        "load": load,
        "primary_resistance": primary_resistance,
        "secondary_resistance": secondary_resistance,
    }
    expected = solved_circuit(sign * m, inductance, omega=omega, **resistances)
    with jax.enable_x64(True):
        value = link_efficiency(np.float64(sign * m), angular_frequency=omega, **resistances)
        assert value.dtype == np.float64
    single = link_efficiency(np.float32(sign * m), angular_frequency=omega, **resistances)
    assert float(value) == pytest.approx(expected, rel=1e-7)
    assert float(single) == pytest.approx(expected, rel=1e-5)
    assert 0 <= float(single) <= 1


@settings(max_examples=100)
@given(
    m=st.floats(1e-8, 1e-3),
    load=st.floats(0.1, 1e3),
    r_med=st.floats(1e-3, 10.0),
    r_ev=st.floats(0.0, 10.0),
)
def test_paper_form_is_eq_6_as_printed(m, load, r_med, r_ev):
    printed = load / ((r_med + load) * (1 + r_med * (r_ev + load) / (OMEGA * m) ** 2))
    args = {"load": load, "primary_resistance": r_med, "secondary_resistance": r_ev}
    with jax.enable_x64(True):
        value = float(link_efficiency(np.float64(m), angular_frequency=OMEGA, form="paper", **args))
        circuit = float(link_efficiency(np.float64(m), angular_frequency=OMEGA, **args))
    assert value == pytest.approx(printed, rel=1e-12)
    assert value / circuit == pytest.approx((r_ev + load) / (r_med + load), rel=1e-12)


@pytest.mark.parametrize(
    ("axial", "lateral", "micro_henry", "efficiency"),
    [
        (0.2, 0.0, 28.3, 0.981),
        (0.2, 0.4, 7.9, 0.905),
        (0.2, 0.5, 2.75, 0.566),
        (0.5, 0.0, 7.7, 0.902),
        (1.0, 0.0, 1.65, 0.323),
    ],
)
def test_default_coils_give_the_reference_links(axial, lateral, micro_henry, efficiency):
    m = mutual_inductance(0.35, 0.30, axial, lateral, 0.0, primary_turns=10, secondary_turns=10)
    half_digit = 0.005 if micro_henry < 3 else 0.05
    assert float(m) * 1e6 == pytest.approx(micro_henry, abs=half_digit)
    # The resistances are printed to 0.001 ohm, which leaves the efficiency 8e-4 of freedom; 0.566
    # and 0.323 come out with the primary's nearer 0.1585 than 0.159 ohm, so compare the intervals.
    r_med, r_ev = np.float32([0.1595, 0.1585]), np.float32([0.1265, 0.1255])
    resistances = {"primary_resistance": r_med, "secondary_resistance": r_ev}
    lowest, highest = link_efficiency(m, **{**DEFAULTS, **resistances})
    assert lowest < efficiency + 5e-4
    assert highest > efficiency - 5e-4


def test_best_load_gives_the_known_maximum():
    # Z_opt = R_EV sqrt(1 + F^2), eta_max = F^2 / (1 + sqrt(1 + F^2))^2.
    m = np.array([1e-7, 2.75e-6, 28.3e-6])
    merit_sq = (OMEGA * m) ** 2 / (0.159 * 0.126)
    best_load = 0.126 * np.sqrt(1 + merit_sq)
    with jax.enable_x64(True):
        best, less, more = (
            np.asarray(link_efficiency(m, **{**DEFAULTS, "load": factor * best_load}))
            for factor in (1.0, 0.99, 1.01)
        )
    np.testing.assert_allclose(best, merit_sq / (1 + np.sqrt(1 + merit_sq)) ** 2, rtol=1e-12)
    assert np.all((less < best) & (more < best))


@pytest.mark.parametrize("form", ["circuit", "paper"])
def test_null_gives_zero_with_a_finite_gradient(form):
    efficiency, slope = jax.value_and_grad(lambda m: link_efficiency(m, form=form, **DEFAULTS))(0.0)
    assert float(efficiency) == 0.0
    assert float(slope) == 0.0


def test_weak_and_strong_coupling_survive_float32():
    m = np.array([1e-22, 1e-16, 1e-10, 1.0, 1e6])
    expected = DEFAULTS["load"] / ((0.126 + 10.0) * (1 + 0.159 * (0.126 + 10.0) / (OMEGA * m) ** 2))
    value = link_efficiency(m.astype(np.float32), **DEFAULTS)
    assert value.dtype == np.float32
    np.testing.assert_allclose(value, expected, rtol=1e-6)
    slope = jax.vmap(jax.grad(lambda x: link_efficiency(x, **DEFAULTS)))(m.astype(np.float32))
    assert np.all(np.isfinite(slope))


def test_broadcasts_and_maps_over_loads():
    m = np.array([1e-6, 1e-5], np.float32)
    load = np.array([[1.0], [10.0], [100.0]], np.float32)
    rest = {k: v for k, v in DEFAULTS.items() if k != "load"}
    value = link_efficiency(m, load=load, **rest)
    assert value.shape == (3, 2)
    mapped = jax.vmap(lambda z: link_efficiency(m, load=z, **rest))(load[:, 0])
    np.testing.assert_allclose(mapped, value, rtol=1e-6)


def test_unknown_form_is_refused():
    with pytest.raises(ValueError, match="form is 'printed', must be 'circuit' or 'paper'"):
        link_efficiency(1e-6, form="printed", **DEFAULTS)


@settings(max_examples=100)
@given(
    m=st.floats(1e-8, 1e-3),
    load=st.floats(0.1, 1e3),
    r_med=st.floats(1e-3, 10.0),
    r_ev=st.floats(0.0, 10.0),
)
def test_input_resistance_is_that_of_the_circuit(m, load, r_med, r_ev):
    """At one ampere: what load, secondary and primary take at the currents that Kirchhoff gives."""
    secondary = OMEGA * m / (r_ev + load)  # A for 1 A in the primary
    args = {"load": load, "primary_resistance": r_med, "secondary_resistance": r_ev}
    with jax.enable_x64(True):
        ohm = float(input_resistance(np.float64(m), angular_frequency=OMEGA, **args))
        efficiency = float(link_efficiency(np.float64(m), angular_frequency=OMEGA, **args))
    assert ohm == pytest.approx(r_med + (r_ev + load) * secondary**2, rel=1e-12)
    assert efficiency * ohm == pytest.approx(load * secondary**2, rel=1e-12)
