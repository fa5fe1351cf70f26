"""What is said of scores, by hand."""

import numpy as np
import pytest

from train.evaluation.summary import summarize
from train.evaluation.tables import format_table


def test_no_share_of_nothing():
    """No action sends nobody to the shoulder in most episodes: there is no interval to give."""
    none = {"return": np.zeros(3), "depleted_share": np.array([0.0, 0.0, 0.1])}
    ours = {"return": np.ones(3), "depleted_share": np.zeros(3)}
    assert "change_against_none" not in summarize({"ppo": ours, "none": none}, "paper", ["ppo"])


def test_several_training_seeds_are_compared_by_their_mean():
    """By hand for two seeds, three episodes."""
    ours = [np.array([1.0, 2.0, 6.0]), np.array([3.0, 2.0, 0.0])]
    scores = {
        name: {"return": returns, "length": np.full(3, 6.0), "mean_range_m": returns + 10.0}
        for name, returns in zip(("ppo", "ppo_seed2"), ours, strict=True)
    }
    scores["none"] = {
        "return": np.zeros(3),
        "length": np.full(3, 6.0),
        "mean_range_m": np.full(3, 10.0),
    }
    learned = ["ppo", "ppo_seed2"]
    result = summarize(scores, "paper", learned)
    assert list(result["paired_return_difference"]) == ["none"]
    assert result["paired_return_difference"]["none"]["mean"] == pytest.approx(7.0 / 3.0)
    assert result["change_against_none"]["mean_range_m"]["mean"] == pytest.approx(0.7 / 3.0)
    seeds = result["training_seeds"]
    assert seeds["return_means"] == pytest.approx([3.0, 5.0 / 3.0])
    assert seeds["interquartile_mean"] == pytest.approx(7.0 / 3.0)
    assert seeds["ci95"] == pytest.approx([5.0 / 3.0, 3.0])
    own = [gains["none"] for gains in seeds["paired_return_differences"]]
    assert [gain["mean"] for gain in own] == pytest.approx([3.0, 5.0 / 3.0])
    assert all(gain["ci95"][0] < gain["mean"] < gain["ci95"][1] for gain in own)
    table = format_table(result, learned)
    assert f"each minus none, 95 % CI: 3.000 [{own[0]['ci95'][0]:.3f}" in table
    # What is of both is not said of the first; and of two seeds no interval is 95 %.
    assert "mean of 2 seeds minus it, 95 % CI" in table
    assert "ppo minus it" not in table
    assert "interquartile mean, bootstrap over 2: 2.333 [1.667, 3.000]" in table
    # Without a rule beside them there is nothing to be above of.
    alone = summarize({name: scores[name] for name in learned}, "paper", learned)
    assert "each minus" not in format_table(alone, learned)


def test_summary_has_the_contracts_names():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=50) * 100
    scores = {
        "ppo": {"return": noise + 5.0, "length": np.full(50, 6.0), "mean_soc": np.full(50, 0.5)},
        "none": {
            "return": noise + rng.normal(size=50),
            "length": np.full(50, 6.0),
            "mean_soc": np.zeros(50),
        },
    }
    result = summarize(scores, "paper", ["ppo"])
    assert result["episodes"] == 50
    assert result["scenario"] == "paper"
    entry = result["policies"]["ppo"]
    assert entry["return_mean"] == pytest.approx(scores["ppo"]["return"].mean())
    assert entry["return_std"] == pytest.approx(scores["ppo"]["return"].std(ddof=1))
    assert entry["mean_soc"] == 0.5
    # The paired difference is far sharper than the two intervals.
    low, high = result["paired_return_difference"]["none"]["ci95"]
    assert 4.0 < low < high < 6.0
    assert np.ptp(entry["return_ci95"]) > 20
