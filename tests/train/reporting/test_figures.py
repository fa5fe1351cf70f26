"""The training curve."""

import numpy as np
import pytest
from matplotlib.image import imread

from train.algorithms.ppo.settings import PPOConfig
from train.reporting.figures import averaged, limits_of_curve, plot_curve


@pytest.mark.parametrize("seeds", [2, 5])
def test_a_curve_of_several_seeds_and_one_of_none(tmp_path, seeds):
    rng = np.random.default_rng(0)
    rows = [{"env_steps": 10, "episode_return": 1.0, "per_seed": {"episode_return": [1.0] * seeds}}]
    rows[0]["per_seed"]["episode_return"][0] = None  # no episode of the first seed has ended
    for number in range(2, 30):
        values = list(number + rng.normal(size=seeds))
        mean = float(np.mean(values))
        row = {"env_steps": 10 * number, "episode_return": mean}
        rows.append(row | {"per_seed": {"episode_return": values}})
    for name, given in (("curve", rows), ("first", rows[:1]), ("none", [])):
        plot_curve(tmp_path / f"{name}.png", given, PPOConfig(), {"none": -1.0, "random": 2.0})
        assert imread(tmp_path / f"{name}.png").std() > 0.02


def test_lines_far_from_the_curve_do_not_flatten_it():
    """A curve from -5 to 20 shows the rule at 7 and slow driving at -25, and leaves -100 and 60 to the legend."""
    curve = np.array([[-5.0, 3.0], [12.0, 20.0]])
    bottom, top = limits_of_curve(curve, [7.0, -25.0, -100.0, 60.0])
    assert (bottom, top) == pytest.approx((-25.0 - 2.25, 20.0 + 2.25))
    assert limits_of_curve(curve, []) == pytest.approx((-6.25, 21.25))
    assert limits_of_curve(np.zeros((0, 2)), [4.0, 14.0]) == pytest.approx((3.5, 14.5))
    bottom, top = limits_of_curve(np.zeros((0, 1)), [])
    assert bottom < 0.0 < top


def test_a_long_curve_is_averaged_over_updates():
    """150 updates become 60 points of two or three: a line stays that line, and noise shrinks."""
    steps = np.arange(150.0)
    line = np.stack([2.0 * steps, -steps], axis=1)
    places, means = averaged(steps, line)
    assert places.shape == (60,)
    np.testing.assert_allclose(means, np.stack([2.0 * places, -places], axis=1))
    np.testing.assert_allclose(places[:2], [1.0, 4.0])
    noise = np.random.default_rng(0).normal(size=(150, 2))
    assert averaged(steps, noise)[1].std() < 0.8 * noise.std()
    few, same = averaged(steps[:7], line[:7])
    np.testing.assert_array_equal(few, steps[:7])
    np.testing.assert_array_equal(same, line[:7])
