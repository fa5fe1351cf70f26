"""The forecast uses the EVs' own speed; tests/policies/test_rules.py checks its values by hand."""

import jax
import numpy as np
import pytest

import medjax
from medjax.charging.energy import cruising
from medjax.env.forecast import expected_need, forecast_need
from medjax.world.kinds import GAS
from medjax.world.state import IN_SERVICE
from tests.charging.scene import put


def test_need_does_not_depend_on_speeds_of_gas_vehicles():
    """Only on the EVs' desired speed."""
    env, params = medjax.make("paper", arrival_soc_low=0.1)
    _, state = jax.jit(env.reset)(jax.random.key(3), params)
    speed = params.drivers.desired_speed

    @jax.jit
    def need(desired):
        drivers = params.drivers.replace(desired_speed=desired)
        return forecast_need(state, env.config, params.replace(drivers=drivers), 60.0)

    usual = need(speed)
    np.testing.assert_array_equal(need(speed.at[GAS].set(22.0)), usual)
    others = np.arange(len(speed)) != GAS
    assert not np.array_equal(need(np.where(others, 40.0, speed)), usual)


def test_who_wants_to_arrive_with_charge_is_in_need_sooner():
    """EVs in need at each ramp, and what they lack, by a loop in float64; half of a battery is to be left."""
    env, params = medjax.make("freight")
    _, state = jax.jit(env.reset)(jax.random.key(3), params)
    need = jax.jit(lambda state: expected_need(state, env.config, params, 60.0))(state)
    speed, power_w = (float(each) for each in cruising(params))
    capacity_j, evs = 600 * 3.6e6, env.config.ev_slots
    x, destination, active = (
        np.asarray(getattr(state.vehicles, name)[evs], np.float64)
        for name in ("x", "destination", "active")
    )
    lacks_j = (destination - x) * power_w / speed - np.asarray(state.evs.energy_j, np.float64)
    lacks_j += 0.5 * capacity_j
    for ramp, place in enumerate(np.asarray(params.road.ramp_x_m, np.float64)):
        near = (place - x <= 2.6 * 60.0) & (place - x >= -400.0) & (lacks_j > 0.0) & (active > 0)
        assert float(need.there[ramp]) == near.sum()
        lacking = lacks_j[near].sum() / capacity_j
        np.testing.assert_allclose(need.shortfall[ramp], lacking, rtol=1e-4, atol=1e-6)
    assert need.there.sum() > 3
    # Whoever enters at the ramp meets a MED that leaves just then; it wants half of a battery and what its way takes.
    wants = 0.5 + (30_000.0 - 1_800.0) * power_w / speed / capacity_j
    expected = 40.0 / 3600.0 * 0.3 * 60.0 * (wants - 0.1) / 0.6
    np.testing.assert_allclose(need.coming[0], expected, rtol=1e-4)


@pytest.mark.parametrize(("ahead_m", "sees"), [(390.0, True), (410.0, False), (-390.0, True)])
def test_free_slots_are_of_meds_that_may_serve_who_is_counted(ahead_m, sees):
    """A lorry 400 m past a ramp may book a MED that joins there, so a MED as near competes with it."""
    env, params = medjax.make("freight")
    _, state = jax.jit(env.reset)(jax.random.key(3), params)
    vehicles = {"active": (0, True), "x": (0, params.road.ramp_x_m[1] + ahead_m), "lane": (0, 1)}
    state = put(state, vehicles=vehicles, meds={"status": (0, IN_SERVICE)})
    need = jax.jit(lambda state: expected_need(state, env.config, params, 60.0))(state)
    np.testing.assert_array_equal(need.free, [0.0, 4.0 * sees, 0.0, 0.0])
