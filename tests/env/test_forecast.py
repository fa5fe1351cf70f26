"""The forecast uses the EVs' own speed; tests/policies/test_rules.py checks its values by hand."""

import jax
import numpy as np

import medjax
from medjax.env.forecast import forecast_need
from medjax.world.kinds import GAS


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
