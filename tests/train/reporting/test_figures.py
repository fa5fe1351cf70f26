"""The training curve."""

import numpy as np
import pytest
from matplotlib.image import imread

from train.algorithms.ppo.settings import PPOConfig
from train.reporting.figures import plot_curve


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
