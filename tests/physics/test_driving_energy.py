"""Energy of driving, against FASTSim's road load and battery energy, and energy conservation."""

from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from medjax.physics import battery_energy, tractive_energy

DATA = Path(__file__).parents[1] / "data"
J_PER_KWH = 3.6e6


def _read(name):
    return np.genfromtxt(DATA / name, delimiter=",", names=True, dtype=None, encoding="utf-8")


CARS = {str(row["vehicle"]): row for row in _read("ev_energy.csv")}


def body(row):
    return {
        "mass": float(row["mass_kg"]),
        "drag_coefficient": float(row["drag_coefficient"]),
        "frontal_area": float(row["frontal_area_m2"]),
        "rolling_resistance": float(row["rolling_resistance"]),
        "rotational_inertia_factor": float(row["rotational_inertia_factor"]),
    }


def kwh_per_100km(joule, distance_m):
    return joule / J_PER_KWH / distance_m * 1e5


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("cycle", ["hwfet", "udds"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_driving_cycles_take_what_fastsim_says(car, cycle, dtype):
    table = _read(f"cycle_{cycle}.csv")
    np.testing.assert_array_equal(np.diff(table["time_s"]), 1)
    speed = table["speed_m_per_s"].astype(dtype)
    with jax.enable_x64(True):
        energy = tractive_energy(speed[:-1], speed[1:], dtype(1.0), **body(CARS[car]))
    assert energy.dtype == dtype
    distance = np.sum((table["speed_m_per_s"][:-1] + table["speed_m_per_s"][1:]) / 2)
    used = kwh_per_100km(np.sum(np.asarray(energy), dtype=np.float64), distance)
    expected = CARS[car][f"{cycle}_net_tractive_kwh_per_100km"]
    assert used == pytest.approx(float(expected), rel=1e-3)


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("speed_km_h", [100, 110, 120, 130])
def test_steady_speeds_take_what_fastsims_battery_gives(car, speed_km_h):
    speed = speed_km_h / 3.6
    wheels = tractive_energy(speed, speed, 1.0, **body(CARS[car]))
    taken = battery_energy(wheels, 1.0, drivetrain_efficiency=0.9, auxiliary_power=250.0)
    expected = CARS[car][f"battery_kwh_per_100km_at_{speed_km_h}kmh"]
    assert kwh_per_100km(float(taken), speed) == pytest.approx(float(expected), rel=0.05)


def test_truck_takes_the_reference_energy():
    speed = 90 / 3.6
    wheels = tractive_energy(
        speed, speed, 1.0, mass=15076, drag_coefficient=0.8, frontal_area=10.0,
        rolling_resistance=0.0092,
    )  # fmt: skip
    taken = battery_energy(wheels, 1.0, drivetrain_efficiency=0.9)
    assert kwh_per_100km(float(taken), speed) / 100 == pytest.approx(1.35, abs=0.005)


NOTHING = {"drag_coefficient": 0.0, "frontal_area": 0.0, "rolling_resistance": 0.0}


@settings(max_examples=100)
@given(
    before=st.floats(0, 50),
    after=st.floats(0, 50),
    dt=st.floats(0.05, 2.0),
    inertia=st.floats(1.0, 1.2),
)
def test_without_resistance_it_is_the_change_of_kinetic_energy(before, after, dt, inertia):
    with jax.enable_x64(True):
        energy = tractive_energy(
            np.float64(before), after, dt, mass=1500.0, rotational_inertia_factor=inertia, **NOTHING
        )
    kinetic = 0.5 * 1500.0 * inertia * (after**2 - before**2)
    assert float(energy) == pytest.approx(kinetic, rel=1e-9, abs=1e-6)
    assert float(energy) <= 1e-6 or after > before


@settings(max_examples=50)
@given(slope=st.floats(-0.2, 0.2), speed=st.floats(0, 40), gravity=st.floats(1.0, 20.0))
def test_a_slope_takes_the_change_of_potential_energy(slope, speed, gravity):
    with jax.enable_x64(True):
        energy = tractive_energy(
            np.float64(speed), speed, 0.25, mass=1500.0, slope=slope, gravity=gravity, **NOTHING
        )
    height = speed * 0.25 * np.sin(slope)
    assert float(energy) == pytest.approx(1500.0 * gravity * height, rel=1e-9, abs=1e-9)


def test_resistances_by_hand():
    # 20 m/s for 0.5 s is 10 m; rolling 1000 * 9.81 * 0.01 N, drag 0.5 * 1.2 * 0.3 * 2 * 400 N.
    rolling = {
        "mass": 1000,
        "drag_coefficient": 0.0,
        "frontal_area": 2.0,
        "rolling_resistance": 0.01,
    }
    drag = rolling | {"drag_coefficient": 0.3, "rolling_resistance": 0.0}
    assert float(tractive_energy(20, 20, 0.5, **rolling)) == pytest.approx(981.0)
    assert float(tractive_energy(20, 20, 0.5, **drag)) == pytest.approx(1440.0)
    assert float(tractive_energy(20, 20, 0.5, air_density=0.6, **drag)) == pytest.approx(720.0)
    assert float(tractive_energy(0, 0, 0.5, **rolling)) == 0.0


def test_battery_pays_for_driving_and_is_paid_for_braking():
    wheels = np.array([900.0, 0.0, -1000.0], np.float32)
    np.testing.assert_allclose(battery_energy(wheels, 0.25), wheels)
    lossy = {"drivetrain_efficiency": 0.9, "regeneration_efficiency": 0.6, "auxiliary_power": 400.0}
    taken = battery_energy(wheels, 0.25, **lossy)
    np.testing.assert_allclose(taken, [1100.0, 100.0, -500.0], rtol=1e-6)
    taken = battery_energy(wheels, 0.25, regeneration_efficiency=0.0)
    np.testing.assert_allclose(taken, [900.0, 0.0, 0.0])


@settings(max_examples=100)
@given(
    wheels=st.floats(-1e6, 1e6),
    drivetrain=st.floats(0.1, 1.0),
    regeneration=st.floats(0.0, 1.0),
)
def test_losses_never_gain_energy(wheels, drivetrain, regeneration):
    efficiency = {"drivetrain_efficiency": drivetrain, "regeneration_efficiency": regeneration}
    taken = battery_energy(np.float32(wheels), 1.0, **efficiency)
    assert float(taken) >= np.float32(wheels) - 1e-6 * abs(wheels)


def test_one_call_serves_a_fleet():
    before = np.array([20.0, 25.0, 30.0], np.float32)
    mass = np.array([1500.0, 1700.0, 15000.0], np.float32)
    rest = {"drag_coefficient": 0.3, "frontal_area": 2.5, "rolling_resistance": 0.008}
    fleet = tractive_energy(before, before + 0.5, 0.25, mass=mass, **rest)
    assert fleet.shape == (3,)
    assert fleet.dtype == np.float32
    alone = jax.vmap(lambda v, m: tractive_energy(v, v + 0.5, 0.25, mass=m, **rest))(before, mass)
    np.testing.assert_allclose(alone, fleet, rtol=1e-6)
