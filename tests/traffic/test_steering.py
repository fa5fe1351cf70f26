"""A change of lanes ends within the lane that it leads to, whatever steering is allowed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.traffic.motion import Steering, lateral_step
from medjax.traffic.road import NOWHERE, keeps_lane, other_lane, spare_width
from medjax.world.params import GROUPS

LORRY_M = 2.55
DRAWS = 4000


def drawn(name, size, rng):
    """Numbers from all of the range that is allowed, as many small ones as large ones."""
    allowed = GROUPS["motion"][name]
    return np.exp(rng.uniform(np.log(allowed.low), np.log(allowed.high), size)).astype(np.float32)


@pytest.mark.parametrize("tick_s", [0.02, 0.1, 0.25, 0.5])
def test_nobody_swings_over_the_far_line(tick_s):
    """However weak the steering is, and wherever the driver wanders to."""
    rng = np.random.default_rng(0)
    lanes = GROUPS["road"]["lane_width_m"]
    lane_m = rng.uniform(lanes.low, lanes.high, DRAWS).astype(np.float32)
    names = ("lateral_rate", "lateral_acceleration", "lateral_speed")
    steering = Steering(*(drawn(name, DRAWS, rng) for name in names))
    aim = keeps_lane(rng.normal(0.0, 2.0, DRAWS).astype(np.float32), LORRY_M, lane_m)
    start = (
        aim[rng.permutation(DRAWS)] * 0.0 - lane_m + keeps_lane(jnp.float32(-9.0), LORRY_M, lane_m)
    )

    @jax.jit
    def farthest(offset):
        def tick(carry, _):
            offset, speed, most = carry
            offset, speed = lateral_step(offset, speed, aim, steering, tick_s)
            return (offset, speed, jnp.maximum(most, offset)), None

        begin = offset, jnp.zeros_like(offset), offset
        return jax.lax.scan(tick, begin, None, length=round(120.0 / tick_s))[0][2]

    most = farthest(start)
    assert (other_lane(jnp.zeros(DRAWS, jnp.int32), most, LORRY_M, lane_m) != 1).all()
    # Nor is the way there just not done: those who steer as drivers do have come to their aims.
    usual = (steering.rate > 1.0) & (steering.speed > 0.5) & (steering.acceleration > 0.5)
    assert usual.sum() > 100
    np.testing.assert_allclose(most[usual], aim[usual], atol=0.06)


def test_the_lanes_of_who_straddles_a_line():
    """A car of 1.8 m in a lane of 4: it has 1.1 m to each side."""
    assert float(spare_width(1.8, 4.0)) == pytest.approx(1.1)
    offset = jnp.array([0.0, 1.09, 1.11, -1.11, -4.0, 4.0])
    lane = jnp.full(6, 2)
    other = other_lane(lane, offset, jnp.full(6, 1.8), 4.0)
    np.testing.assert_array_equal(other, [NOWHERE, NOWHERE, 3, 1, 1, 3])
