"""A lane change ends within the lane that it leads to, whatever steering is allowed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.traffic.motion import Steering, lateral_step
from medjax.traffic.road import clip_lateral_aim, straddled_lane
from medjax.world.params import GROUPS

LORRY_M, DRAWS = 2.55, 4000


def drawn(name, rng):
    """Numbers from all of the allowed range, logarithmically."""
    allowed = GROUPS["motion"][name]
    logs = rng.uniform(np.log(allowed.low), np.log(allowed.high), DRAWS)
    return np.exp(logs).astype(np.float32)


@pytest.mark.parametrize("tick_s", [0.02, 0.1, 0.25, 0.5])
def test_a_lane_change_ends_within_its_lane(tick_s):
    """However weak the steering is, and wherever the driver wanders to."""
    rng = np.random.default_rng(0)
    lanes = GROUPS["road"]["lane_width_m"]
    lane_m = rng.uniform(lanes.low, lanes.high, DRAWS).astype(np.float32)
    names = ("lateral_rate", "lateral_acceleration", "lateral_speed")
    steering = Steering(*(drawn(name, rng) for name in names))
    aim = clip_lateral_aim(rng.normal(0.0, 2.0, DRAWS).astype(np.float32), LORRY_M, lane_m)
    start = clip_lateral_aim(jnp.float32(-9.0), LORRY_M, lane_m) - lane_m

    @jax.jit
    def farthest(offset):
        def tick(carry, _):
            offset, speed, most = carry
            offset, speed = lateral_step(offset, speed, aim, steering, tick_s)
            return (offset, speed, jnp.maximum(most, offset)), None

        begin = offset, jnp.zeros_like(offset), offset
        return jax.lax.scan(tick, begin, None, length=round(120.0 / tick_s))[0][2]

    most = farthest(start)
    assert (straddled_lane(jnp.zeros(DRAWS, jnp.int32), most, LORRY_M, lane_m) != 1).all()
    # With usual steering they have arrived.
    usual = (steering.rate > 1.0) & (steering.speed > 0.5) & (steering.acceleration > 0.5)
    assert usual.sum() > 100
    np.testing.assert_allclose(most[usual], aim[usual], atol=0.06)
