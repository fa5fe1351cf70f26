"""When greedy counts as beaten, and when that was."""

import numpy as np
import pytest

from benchmarks.speed import checkpoints
from benchmarks.speed.checkpoints import Checkpoint
from tests.benchmarks.speed.made_runs import SUMMARY, write_run


def test_time_of_an_update_is_its_line_of_the_metrics(tmp_path):
    run_dir = write_run(tmp_path / "run", SUMMARY, update_s=0.5, from_s=10.0)
    assert checkpoints.reached_s(run_dir, 8) == 14.0


def test_a_checkpoint_is_compared_in_pairs():
    """Episodes differ by hundreds, the policies by 5 +- 1 in each: plainly above, and plainly below."""
    rng = np.random.default_rng(0)
    greedy = rng.normal(-150.0, 300.0, 64)
    ours = greedy + rng.normal(5.0, 1.0, 64)
    point = checkpoints.compare(12, ours, greedy, seed=0)
    assert point.update == 12
    assert point.return_mean == pytest.approx(ours.mean())
    low, high = point.gain_ci95
    assert 4.4 < low < 5.0 < high < 5.6
    assert checkpoints.compare(12, greedy, ours, seed=0).gain_ci95[1] < 0


def test_first_beaten_is_the_first_surely_above():
    """A mean above greedy is not enough, nor is a bound of 0; what comes later does not matter."""
    below = Checkpoint(4, -200.0, (-60.0, -40.0))
    unsure = Checkpoint(8, -140.0, (-5.0, 25.0))
    equal = Checkpoint(12, -150.0, (0.0, 0.0))
    above = Checkpoint(16, -120.0, (20.0, 40.0))
    again = Checkpoint(20, -160.0, (-20.0, 0.5))
    assert checkpoints.first_beaten([below, unsure, equal, above, again]) is above
    assert checkpoints.first_beaten([below, unsure, equal, again]) is None
    assert checkpoints.first_beaten([]) is None
