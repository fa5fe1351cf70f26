"""A tick of traffic takes its drivers and its car-following model from the caller."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.env import ChargingEnv
from medjax.traffic.step import drivers_of
from medjax.world.kinds import MED
from medjax.world.state import IN_SERVICE, MERGING

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_a_med_drives_as_its_kind_until_it_is_in_service():
    """Then at the fleet's service speed; the state keeps the driver's own."""
    desired_speed = [24.0, 30.0, 30.0, 30.0, 24.0]
    env, params = medjax.make("paper", desired_speed=desired_speed, service_speed=19.0)
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    status = state.meds.status.at[0].set(IN_SERVICE).at[1].set(MERGING)
    state = state.replace(meds=state.meds.replace(status=status))
    drivers = drivers_of(state, env.config, params)
    np.testing.assert_array_equal(drivers.desired_speed[:3], [19.0, 24.0, 24.0])
    others = env.config.traffic_slots
    np.testing.assert_array_equal(
        drivers.desired_speed[others], state.vehicles.desired_speed[others]
    )
    np.testing.assert_array_equal(state.vehicles.desired_speed[env.config.med_slots], 24.0)
    assert (np.asarray(state.vehicles.kind[env.config.med_slots]) == MED).all()


@dataclasses.dataclass(frozen=True)
class Coasting:
    """A car-following model: every vehicle slows down alike."""

    deceleration: float

    def prepare(self, drivers: Any, speed: Any) -> None:
        """It prepares nothing."""

    def acceleration(self, follower: Any, gap: Any, leader_speed: Any) -> jax.Array:
        """The same for all."""
        return jnp.full(gap.shape, -self.deceleration)


@pytest.mark.thorough
def test_a_custom_model_drives_all_vehicles():
    """After a decision of a second, every vehicle is slower by the model's deceleration."""
    made, params = medjax.make("paper", acceleration_noise=0.0)
    env = ChargingEnv(made.config, following=Coasting(0.5))
    _, state = jax.jit(env.reset)(jax.random.key(0), params)
    after = jax.jit(env.step_env)(jax.random.key(1), state, 0, params)[1]
    stays = state.vehicles.active & after.vehicles.active
    slower = np.asarray(state.vehicles.speed - after.vehicles.speed)[np.asarray(stays)]
    assert slower.size > 50
    np.testing.assert_allclose(slower, 0.5, atol=1e-4)
