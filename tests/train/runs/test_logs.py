"""What is said of updates."""

import numpy as np

from train.runs.logs import final_return, rows_from


def test_rows_average_over_the_seeds_that_have_a_value():
    metrics = {"episode_return": np.array([[1.0, np.nan, 9.0], [3.0, 5.0, 9.0]])}
    rows = rows_from(metrics, 2)
    assert [row["episode_return"] for row in rows] == [2.0, 5.0]
    assert rows[1]["per_seed"]["episode_return"] == [None, 5.0]
    assert rows_from({"loss": np.array([np.nan, 1.0])}, 2) == [{"loss": None}, {"loss": 1.0}]


def test_final_return_weighs_episodes():
    rows = [{"episode_return": None, "episodes": 0.0}] * 18
    assert final_return(rows) is None
    rows = [
        *rows,
        {"episode_return": 1.0, "episodes": 3.0},
        {"episode_return": 5.0, "episodes": 1.0},
    ]
    assert final_return(rows) == 2.0
