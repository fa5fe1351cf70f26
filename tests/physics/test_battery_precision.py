"""What rounding does to a battery, on the preset of the largest packs: the bounds of docs/precision.md."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.physics import change_battery

pytestmark = pytest.mark.usefixtures("quick_compiles")

ROUNDING = 2.0**-24  # of float32, relative


@pytest.fixture(scope="module")
def long():
    return medjax.make("long")


@pytest.mark.parametrize("use_j", [250.0, 20.0, 14827.3, -37.7])
def test_small_loads_of_a_truck_add_up(long, use_j):
    """180,000 ticks, an hour of the shortest, in the pack that rounds to 128 J."""
    _, params = long
    capacity = params.med_capacity_j
    ticks, start = 180_000, np.float32(0.9 * float(capacity))
    use = np.float32(use_j / 12.5)  # of 0.02 s

    def tick(carry, _):
        (energy, rest), plain = carry
        return (change_battery(energy, rest, -use, capacity), plain - use), None

    zero = jnp.zeros(())
    ((energy, rest), plain), _ = jax.lax.scan(
        tick, ((jnp.asarray(start), zero), jnp.asarray(start)), length=ticks
    )
    exact = np.float64(start) - ticks * np.float64(use)
    ulp = float(np.spacing(start))
    assert ulp == 128.0 or start < 2**30
    assert abs(float(energy) + float(rest) - exact) <= ticks * ROUNDING * (ulp + abs(float(use)))
    assert abs(float(energy) - exact) <= ulp
    # Without the rest, ticks of less than half a unit would be lost altogether.
    if abs(use) < 0.5 * ulp:
        assert float(plain) == start


def test_batteries_against_float64(long):
    """Driving, braking and charging at random, an hour, in packs of 30 kWh, full and nearly empty."""
    _, params = long
    rng = np.random.default_rng(5)
    changes = rng.normal(0.0, 3000.0, (14_400, 64)).astype(np.float32)
    capacity = float(params.ev_capacity_j)
    start = rng.uniform(0.3, 0.7, 64).astype(np.float32) * np.float32(capacity)

    def tick(carry, change):
        return change_battery(*carry, change, capacity), None

    (energy, rest), _ = jax.lax.scan(tick, (jnp.asarray(start), jnp.zeros(64)), changes)
    exact = start + changes.astype(np.float64).sum(axis=0)
    assert ((exact > 0.0) & (exact < capacity)).all()
    assert np.abs(np.asarray(energy, np.float64) + rest - exact).max() <= 14_400 * ROUNDING * 2e4
    assert np.abs(energy - exact).max() <= np.spacing(np.float32(capacity))


def test_a_battery_ends_at_empty_and_at_full():
    """Energy beyond either end is dropped, with its rest."""
    energy, rest = change_battery(
        *jnp.float32([[5.0, 95.0], [0.2, 0.4]]), jnp.float32([-9, 9]), 100.0
    )
    np.testing.assert_array_equal(energy, [0.0, 100.0])
    np.testing.assert_array_equal(rest, [0.0, 0.0])
