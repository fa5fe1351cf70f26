"""The summary of scores, by hand."""

import json

import numpy as np
import pytest

from medjax.env.reward import REWARDS
from medjax.episodes.verdict import LINES, NAMES
from medjax.files import write_json
from train.evaluation.comparison import Comparison
from train.evaluation.summary import learned_names, summarize
from train.evaluation.tables import format_table, headline, is_papers, paper_rows


def test_no_share_of_nothing():
    """No action leaves nobody without energy in most episodes, so that a share has no interval."""
    none = {"return": np.zeros(3), "depleted_share": np.array([0.0, 0.0, 0.1])}
    ours = {"return": np.ones(3), "depleted_share": np.zeros(3)}
    assert "change_against_none" not in summarize({"ppo": ours, "none": none}, "paper", ["ppo"])


def test_several_training_seeds_are_compared_by_their_mean():
    """By hand for two seeds, three episodes."""
    ours = [np.array([1.0, 2.0, 6.0]), np.array([3.0, 2.0, 0.0])]
    learned = ["ppo", "ppo_seed2"]
    scores = {
        name: {"return": returns, "length": np.full(3, 6.0), "mean_range_m": returns + 10.0}
        for name, returns in zip([*learned, "none"], [*ours, np.zeros(3)], strict=True)
    }
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
    # A gain of both seeds is not called the first one's; and the interval of two seeds is not called 95 %.
    assert "mean of 2 seeds minus it, bootstrap over 2 and episodes" in table
    assert "mean of 2 seeds here, bootstrap over 2 and episodes" in table
    assert "ppo minus it" not in table
    assert "interquartile mean, bootstrap over 2: 2.333 [1.667, 3.000]" in table
    # The initial policy is not a learned one: each seed is compared with it, even if a rule is better.
    began = {"start": scores["none"] | {"return": np.full(3, -1.0)}}
    assert learned_names(scores | began) == learned
    table = format_table(summarize(scores | began, "paper", learned), learned)
    assert "each minus start, 95 % CI: 4.000 [2.000" in table
    assert table.count("each minus") == 2
    # A start that is better than every rule does not take the best rule's line.
    better = {"start": scores["none"] | {"return": np.full(3, 9.0)}}
    table = format_table(summarize(scores | better, "paper", learned), learned)
    assert "each minus none" in table
    assert "each minus start" in table
    # Nor is one that samples, which is no rule to be compared with even if it is the best.
    sampled = {"ppo_sampled": scores["ppo"] | {"return": np.full(3, 9.0)}}
    assert learned_names(scores | sampled) == learned
    table = format_table(summarize(scores | sampled, "paper", learned), learned)
    assert "each minus none" in table
    assert "each minus ppo_sampled" not in table
    # Without a rule there is nothing to compare with.
    alone = summarize({name: scores[name] for name in learned}, "paper", learned)
    assert "each minus" not in format_table(alone, learned)


def test_seeds_that_differ_give_a_wide_interval():
    """Episodes alone would give an interval of a tenth, though one of the three seeds is below the rule."""
    rng = np.random.default_rng(0)
    none = {"return": rng.normal(size=1000) * 100, "mean_soc": np.full(1000, 0.5)}
    scores = {
        name: {"return": none["return"] + rng.normal(gain, 1.0, 1000), "mean_soc": 0.5 + gain / 100}
        for name, gain in (("ppo", -9.0), ("ppo_seed2", 6.0), ("ppo_seed3", 9.0))
    }
    for score in scores.values():
        score["mean_soc"] = np.full(1000, score["mean_soc"])
    result = summarize(scores | {"none": none}, "paper", [*scores])
    found = result["paired_return_difference"]["none"]
    assert found["mean"] == pytest.approx(2.0, abs=0.1)
    # Of 27 resamples of three seeds one is three times the lowest, one three times the highest.
    assert found["ci95"] == pytest.approx([-9.0, 9.0], abs=0.2)
    assert "can be seen with 3 seeds and 1000 episodes" in format_table(result, [*scores])
    assert result["change_against_none"]["mean_soc"]["mean"] == pytest.approx(0.04)
    assert result["change_against_none"]["mean_soc"]["ci95"] == pytest.approx([-0.18, 0.18])
    own = [gains["none"]["ci95"] for gains in result["training_seeds"]["paired_return_differences"]]
    assert all(high - low < 0.2 for low, high in own)  # of one seed: over episodes alone


def test_a_custom_metric_may_be_nan(tmp_path):
    """It is None in the file, and the table leaves its column out."""
    score = {"return": np.zeros(3), "length": np.full(3, 6.0), "mean_soc": np.full(3, 0.5)}
    scores = {"none": score | {"mine": np.array([1.0, np.nan, 2.0])}}
    scores["ppo"] = score | {"mine": np.ones(3), "mean_range_m": np.full(3, np.inf)}
    scores["none"]["mean_range_m"] = np.ones(3)
    result = summarize(scores, "paper", ["ppo"])
    write_json(tmp_path / "out.json", result)
    assert json.loads((tmp_path / "out.json").read_text()) == result
    assert result["policies"]["none"]["mine"] is None
    assert result["policies"]["ppo"]["mine"] == 1.0
    table = format_table(result, ["ppo"])
    assert "mean SoC" in table
    assert "mean range m" not in table.split("against no action")[0]


@pytest.mark.parametrize("baseline", [None, "none"])
def test_a_return_may_be_nan(tmp_path, baseline):
    """Its mean, its differences and their intervals are None in the file and "-" in the tables, its row is the last."""
    learned = ["ppo", "ppo_seed2"]
    returns = {"none": [0.0, 0.5, 1.0], "ppo": [1.0, np.nan, 2.0], "ppo_seed2": [3.0, 4.0, 5.0]}
    terms = {"length": np.full(3, 6.0), "reward_mine": np.array([1.0, np.nan, 2.0])}
    scores = {name: {"return": np.array(values), **terms} for name, values in returns.items()}
    result = summarize(scores, "paper", learned, baseline=baseline)
    write_json(tmp_path / "out.json", result)
    assert json.loads((tmp_path / "out.json").read_text()) == result
    nothing = {"mean": None, "ci95": [None, None]}
    entry = result["policies"]["ppo"]
    assert (entry["return_mean"], entry["return_std"]) == (None, None)
    assert entry["return_ci95"] == nothing["ci95"]
    assert result["policies"]["none"]["return_mean"] == 0.5
    assert result["paired_return_difference"]["none"]["mean"] is None
    seeds = result["training_seeds"]
    assert seeds["return_means"] == [None, 4.0]
    assert (seeds["interquartile_mean"], seeds["ci95"]) == (None, [None, None])
    first, second = seeds["paired_return_differences"]
    assert first["none"] == nothing
    assert second["none"]["mean"] == 3.5
    if baseline is not None:
        assert result["difference_from_baseline"]["ppo"] == nothing
        assert result["difference_from_baseline"]["ppo_seed2"]["mean"] == 3.5
    table = format_table(result, learned)
    for said in ("nan", "None", "inf "):
        assert said not in table
    rows = [line.split() for line in table.split("\n\n")[0].splitlines()[3:]]
    assert [row[0] for row in rows] == ["ppo_seed2", "none", "ppo"]
    assert rows[2][1:4] == ["-", "[-,", "-]"]
    assert "training seeds: -, 4.000; interquartile mean" in table
    assert paper_rows(result, learned)[3][1:] == ["- (-)", "[-, -]"]


def test_the_heading_names_a_changed_reward():
    """By the terms that were paid; the paper's figures then do not apply."""
    paper, money = ({f"reward_{name}": np.zeros(3) for name in REWARDS[each]} for each in REWARDS)
    for scenario, terms, there in (
        ("paper", paper, None),
        ("corridor", money, None),
        ("paper-own", money, None),
        ("paper", money, "reward of delay_h"),
        ("paper", paper | {"reward_mine": np.ones(3)}, "mine"),
    ):
        result = summarize({"none": {"return": np.zeros(3)} | terms}, scenario, [])
        heading = headline(result)
        assert is_papers(result) == (scenario == "paper" and there is None)
        if there is None:
            assert heading == f"3 whole episodes of {scenario} of seed 0, the same for every policy"
        else:
            assert there in heading
    agents = {"return": np.zeros(3), "told_speed": np.full(3, 20.0)} | paper
    assert not is_papers(summarize({"none": agents}, "paper", []))


def test_the_verdicts_intervals_are_of_whole_lines():
    """Terms of a line may cancel in each episode, which intervals of the terms would miss."""
    rng = np.random.default_rng(1)
    scores = {name: rng.normal(1.0, 0.1, 400) for name in NAMES if name != "return_mean"}
    scores |= {"return": rng.normal(size=400), "length": np.full(400, 6.0)}
    scores["gas_delay_h"] = 3.0 - scores["ev_delay_h"]
    result = summarize({"mine": scores}, "paper", [])
    found = result["policies"]["mine"]["verdict_ci95"]
    assert [*found, "return"] == [line.title for line in LINES]
    assert found["hours of delay"] == pytest.approx([3.0, 3.0])
    low, high = found["ran out"]
    middle, half = scores["evs_depleted"].mean(), 1.96 * scores["evs_depleted"].std() / 20.0
    assert (low, high) == pytest.approx((middle - half, middle + half), abs=0.1 * half)
    scores["energy_drawn_kwh"] = np.full(400, np.nan)
    less = summarize({"mine": scores}, "paper", [])["policies"]["mine"]["verdict_ci95"]
    assert {*found} - {*less} == {"cost, EUR"}
    (row,) = Comparison(result, {"mine": scores}).rows()
    assert all(isinstance(value, str | float) for value in row.values())


def test_a_paired_difference_is_sharper_than_the_intervals():
    rng = np.random.default_rng(0)
    noise, length = rng.normal(size=50) * 100, np.full(50, 6.0)
    none = {"return": noise + rng.normal(size=50), "length": length, "mean_soc": np.zeros(50)}
    ppo = {"return": noise + 5.0, "length": length, "mean_soc": np.full(50, 0.5)}
    scores = {"ppo": ppo, "none": none}
    result = summarize(scores, "paper", ["ppo"])
    assert result["episodes"] == 50
    assert result["scenario"] == "paper"
    entry = result["policies"]["ppo"]
    assert entry["return_mean"] == pytest.approx(scores["ppo"]["return"].mean())
    assert entry["return_std"] == pytest.approx(scores["ppo"]["return"].std(ddof=1))
    assert entry["mean_soc"] == 0.5
    assert entry["verdict_ci95"] == {}  # its metrics are missing
    low, high = result["paired_return_difference"]["none"]["ci95"]
    assert 4.0 < low < high < 6.0
    assert np.ptp(entry["return_ci95"]) > 20
