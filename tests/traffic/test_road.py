"""Where acceleration lanes end and lanes lie, by plain arithmetic."""

import numpy as np
import pytest

from medjax.traffic.road import lateral_position, merge_distance


@pytest.fixture(scope="module")
def road(quiet):
    return quiet[1].road


@pytest.mark.parametrize("ramp", range(4))
def test_merge_distance(road, ramp):
    """250 m at the ramp, 0 at the end of its own lane, whatever other ramps there are."""
    start = [100.0, 1200.0, 2100.0, 3200.0][ramp]
    x = start + np.array([0.0, 100.0, 249.0, 250.0])
    np.testing.assert_allclose(merge_distance(x, road), [250.0, 150.0, 1.0, 0.0])


def test_just_past_the_end_is_still_that_lane(road):
    """A bumper rounded past the end sees an obstacle at hand, not the end of the next lane."""
    np.testing.assert_allclose(
        merge_distance(np.array([350.5, 3450.1]), road), [-0.5, -0.1], atol=1e-3
    )


def test_beyond_the_last_ramp_there_is_no_end(road):
    """So does a road without ramps."""
    none = road.replace(ramp_x_m=np.zeros(0, np.float32))
    assert np.isinf(merge_distance(np.array([3600.0]), road)).all()
    assert np.isinf(merge_distance(np.array([0.0, 100.0]), none)).all()


def test_lateral_position():
    """Centres are 4 m apart, offsets count to the right."""
    lane, offset = np.array([0, 1, 3, 4]), np.array([0.0, -1.5, 0.5, 4.0])
    np.testing.assert_allclose(lateral_position(lane, offset, 4.0), [0.0, 2.5, 12.5, 20.0])
