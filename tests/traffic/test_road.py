"""Where acceleration lanes end and lanes lie, by plain arithmetic."""

import jax.numpy as jnp
import numpy as np
import pytest

from medjax.traffic.road import (
    NO_LANE,
    lateral_position,
    merge_distance,
    spare_width,
    straddled_lane,
)


@pytest.fixture(scope="module")
def road(quiet):
    return quiet[1].road


def test_merge_distance(road):
    """250 m at the ramp, 0 at the end of its own lane; a bumper rounded past the end still belongs to this lane."""
    x = np.float32([[100.0], [1200.0], [2100.0], [3200.0]])
    x = x + np.float32([0.0, 100.0, 249.0, 250.0, 250.5])
    np.testing.assert_allclose(merge_distance(x, road), [[250.0, 150.0, 1.0, 0.0, -0.5]] * 4)
    past = merge_distance(np.array([350.5, 3450.1]), road)
    np.testing.assert_allclose(past, [-0.5, -0.1], atol=1e-3)


def test_beyond_the_last_ramp_there_is_no_end(road):
    none = road.replace(ramp_x_m=np.zeros(0, np.float32))
    assert np.isinf(merge_distance(np.array([3600.0]), road)).all()
    assert np.isinf(merge_distance(np.array([0.0, 100.0]), none)).all()


def test_lateral_position():
    """Centres are 4 m apart, offsets count to the right."""
    lane, offset = np.array([0, 1, 3, 4]), np.array([0.0, -1.5, 0.5, 4.0])
    np.testing.assert_allclose(lateral_position(lane, offset, 4.0), [0.0, 2.5, 12.5, 20.0])


def test_the_second_lane_of_a_straddling_vehicle():
    """A car of 1.8 m in a lane of 4 has 1.1 m to each side."""
    assert float(spare_width(1.8, 4.0)) == pytest.approx(1.1)
    offset = jnp.array([0.0, 1.09, 1.11, -1.11, -4.0, 4.0])
    other = straddled_lane(jnp.full(6, 2), offset, jnp.full(6, 1.8), 4.0)
    np.testing.assert_array_equal(other, [NO_LANE, NO_LANE, 3, 1, 1, 3])
