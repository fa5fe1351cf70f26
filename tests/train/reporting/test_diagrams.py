"""The bins that dispatches are drawn in, and the colours of MEDs."""

import numpy as np
import pytest

from medjax.render.colors import soc_color
from train.reporting.diagrams import CHARGING, MED, _in_bins


@pytest.mark.parametrize("colour", [MED, CHARGING])
def test_no_charge_has_the_colour_of_a_med(colour):
    """Far from every colour of the scale that EVs are drawn in: a quarter of the way from black to white."""
    own = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    scale = np.array([soc_color(share) for share in np.linspace(0.0, 1.0, 101)])
    assert np.linalg.norm(scale - own, axis=1).min() > np.linalg.norm([255] * 3) / 4


def test_bins_of_time_keep_the_total():
    values = np.random.default_rng(0).random((10, 2))
    edges = np.array([0, 4, 8, 10])
    means = _in_bins(values, edges)
    np.testing.assert_allclose((means * np.diff(edges)[:, None]).sum(axis=0), values.sum(axis=0))
    np.testing.assert_allclose(means[2], values[8:].mean(axis=0))
