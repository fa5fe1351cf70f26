"""Tables of an evaluation."""

from train.evaluation.tables import claim_rows, format_table, paper_rows


def test_table_lists_the_best_first():
    entry = {"return_mean": 1.0, "return_ci95": [0.5, 1.5], "depleted_share": 0.25}
    result = {
        "episodes": 3,
        "scenario": "paper",
        "policies": {"none": entry, "ppo": entry | {"return_mean": 123.456}},
        "paired_return_difference": {"none": {"mean": 122.456, "ci95": [100.0, 140.0]}},
    }
    lines = format_table(result, ["ppo"]).splitlines()
    assert "depleted share" in lines[1]
    assert "mean SoC" not in lines[1]
    assert lines[3].startswith("ppo")
    assert "123.5" in lines[3]
    assert "122.5 [100.0, 140.0]" in lines[4]
    assert len(lines) == 5
    slowness = {"ev_saved_kwh": 0.1234, "ev_delay_h": 1.5}
    result["policies"] = {name: each | slowness for name, each in result["policies"].items()}
    *_, headings, _, best, _ = format_table(result, ["ppo"]).splitlines()
    assert headings.split("  ")[0] == "policy"
    assert "saved kWh/EV  EV delay h" in headings
    assert best.split() == ["ppo", "0.123", "1.50"]


def test_tables_of_several_training_seeds():
    entry = {"return_mean": 1.0, "return_std": 2.0, "return_ci95": [0.5, 1.5]}
    seeds = {"return_means": [1.0, 3.0], "interquartile_mean": 2.0, "ci95": [1.0, 3.0]}
    change = {"mean": -0.5, "ci95": [-0.625, -0.375]}
    result = {
        "scenario": "paper",
        "policies": {
            "ppo": entry | {"meds_dispatched": 2.0},
            "none": entry | {"return_mean": -7.0},
        },
        "training_seeds": seeds,
        "change_against_none": {"depleted_share": change},
    }
    result["policies"]["ppo_seed2"] = entry | {"return_mean": 3.0, "meds_dispatched": 4.0}
    learned = ["ppo", "ppo_seed2"]
    rows = paper_rows(result, learned)
    assert [row[0] for row in rows[1:4]] == ["ppo_seed2", "ppo", "none"]
    assert rows[-1][1:] == ["-", "2.000", "[1.000, 3.000]"]
    claims = {row[0]: row[1:] for row in claim_rows(result, learned)}
    assert claims["depleted share"] == ["-50%", "-50.0% [-62.5%, -37.5%]"]
    assert claims["mean SoC"] == ["+20%", "-"]
    assert claims["MEDs sent"] == ["15", "3.00"]
    for other in ({"scenario": "long"}, {"overrides": {"num_evs": 4}}):  # not the paper's world
        claims = {row[0]: row[1:] for row in claim_rows(result | other, learned)}
        assert claims["depleted share"] == ["-50.0% [-62.5%, -37.5%]"]


def test_differences_without_a_sure_sign_are_named():
    """From the baseline, or from the best rule; nothing where each difference has a sign."""
    entry = {"return_mean": 1.0, "return_ci95": [0.5, 1.5]}
    slow, none = ({"return_mean": mean} for mean in (-1.0, -7.0))
    policies = {"ppo": entry, "slow": entry | slow, "none": entry | none}
    result = {"episodes": 64, "scenario": "paper", "policies": policies, "seed": 3}
    result["overrides"] = {"num_evs": 4}
    gains = {
        "slow": {"mean": 1.8, "ci95": [-15.0, 19.0]},
        "none": {"mean": 8.0, "ci95": [7.0, 9.0]},
    }
    trained = format_table(result | {"paired_return_difference": gains}, ["ppo"])
    assert trained.startswith("64 whole episodes of paper (num_evs = 4) of seed 3, the same for")
    seen = "between ppo and slow can be seen with 64 episodes: 1.800 [-15.00, 19.00]; one of 17.00 could be"
    assert seen in trained
    # Without a policy that plays its most probable actions there is nothing to compare with.
    sampled = dict.fromkeys(("ppo", "ppo_sampled"), entry)
    alone = result | {
        "policies": sampled,
        "paired_return_difference": {"ppo_sampled": gains["none"]},
    }
    assert "between" not in format_table(alone, ["ppo"])
    compared = {
        "baseline": "none",
        "difference_from_baseline": {"ppo": gains["none"], "slow": gains["slow"]},
    }
    table = format_table(result | compared, [])
    assert "between slow and none" in table
    assert "ppo and" not in table
    same = {"mean": 0.0, "ci95": [0.0, 0.0]}
    compared["difference_from_baseline"] = {"slow": same}
    assert "slow returned what none did in each of the 64 episodes" in format_table(
        result | compared, []
    )
