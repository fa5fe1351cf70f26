"""Which numbers land in which row of a study, where the scores of its policies are given."""

import argparse
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.studies import calibrate, generalization, planner, ticks, tune
from benchmarks.studies.ablation import sweeps, weights

EPISODES = 3


def scores_of(value, columns):
    """Metrics of three episodes around `value`; the n-th metric is `value` + 1000 n."""
    return {
        column.metric: value + 1000.0 * number + np.array([-1.0, 0.0, 1.0])
        for number, column in enumerate(columns)
    }


def options(**more):
    common = {"episodes": EPISODES, "seed": 0, "scenario": "paper", "stochastic": False}
    return argparse.Namespace(**common | more)


@pytest.fixture
def no_world(monkeypatch):
    """Settings without an environment."""
    config = SimpleNamespace(scenario="paper", overrides={}, algorithm="ppo")
    config.num_updates, config.steps_per_update = 5, 20
    config.for_episodes = lambda decisions: config
    for module in (sweeps, weights):
        monkeypatch.setattr(module, "settings", lambda options: config)
        monkeypatch.setattr(module, "check_environment", lambda config: None)
        monkeypatch.setattr(module, "rules", lambda env: {"none": None, "greedy": None})
        copied = SimpleNamespace(replace=lambda config, **changes: config)
        monkeypatch.setattr(module, "dataclasses", copied)


def side_by_side(worlds, columns):
    """Scores `(worlds, episodes)`, of worlds one after the other."""
    each = [scores_of(value, columns) for value in worlds]
    return {metric: np.stack([world[metric] for world in each]) for metric in each[0]}


def test_sweeps(no_world, monkeypatch, capsys):
    """A row for each policy and value; changes are from the first value asked for."""
    asked = {}

    def play_worlds(env, params, numbers, policies, episodes, seed):
        asked.update(numbers=numbers, policies=[*policies], episodes=episodes)
        return {
            "ppo": side_by_side((10.0, 30.0, 70.0), sweeps.COLUMNS),
            "none": side_by_side((-5.0, -5.0, -6.0), sweeps.COLUMNS),
        }

    monkeypatch.setattr(sweeps, "play_worlds", play_worlds)
    found = {"ppo": None, "none": None, "random": None}
    monkeypatch.setattr(sweeps, "load", lambda *given: (None, None, found))
    report = sweeps.run("cooldown", options(values=[20.0, 5.0, 40.0]))
    np.testing.assert_array_equal(asked["numbers"]["fleet.cooldown_s"], [20.0, 5.0, 40.0])
    assert asked["policies"] == ["ppo", "none", "greedy"]  # a rule comes from `rules` alone
    rows = {(row["policy"], row["value"]): row for row in report["rows"]}
    changes = {key: (row["return"], row["return_change"]) for key, row in rows.items()}
    assert changes == {
        ("ppo", 20): (10.0, 0.0),
        ("ppo", 5): (30.0, 20.0),
        ("ppo", 40): (70.0, 60.0),
        ("none", 20): (-5.0, 0.0),
        ("none", 5): (-5.0, 0.0),
        ("none", 40): (-6.0, -1.0),
    }
    assert rows["ppo", 40]["depleted_share"] == 1070.0
    assert rows["ppo", 5]["return_change_ci95"] == [20.0, 20.0]
    (line,) = [
        line for line in capsys.readouterr().out.splitlines() if line.split()[:2] == ["ppo", "5"]
    ]
    assert line.split()[2].startswith("30")


def test_weights(no_world, monkeypatch, capsys):
    """Learners in the order of the costs that they were trained for, then the rules."""
    asked = {}

    def train_worlds(env, params, numbers, config):
        asked["trained"] = numbers
        return "learned"

    def play_worlds(env, params, numbers, learned, episodes, seed, own_weights):
        asked.update(played=numbers, learned=learned, own_weights=own_weights)
        return {"ppo": side_by_side((1.0, 2.0, 3.0), weights.COLUMNS)}

    played = {"none": scores_of(8.0, weights.COLUMNS), "greedy": scores_of(9.0, weights.COLUMNS)}
    for name, stub in {
        "make_environment": lambda config: (None, None),
        "episode_decisions": lambda params: 600,
        "train_worlds": train_worlds,
        "algorithm_of": lambda config: SimpleNamespace(policy=lambda env, config, own, _: own),
        "play_worlds": play_worlds,
        "evaluate_policies": lambda *given: played,
    }.items():
        monkeypatch.setattr(weights, name, stub)
    given = options(decisions=100, dispatches=[0.0, 20.0], gas_delay=[0.1])
    report = weights.run(given)
    keys = ("policy", "dispatches", "gas_delay", "depleted_share", "meds_dispatched")
    assert [tuple(row.get(key) for key in keys) for row in report["rows"]] == [
        ("ppo", 0.0, 0.0, 1.0, 1001.0),
        ("ppo", 20.0, 0.0, 2.0, 1002.0),
        ("ppo", 0.0, 0.1, 3.0, 1003.0),
        ("none", None, None, 8.0, 1008.0),
        ("greedy", None, None, 9.0, 1009.0),
    ]
    assert asked["own_weights"] is True
    assert asked["learned"] == {"ppo": "learned"}
    for numbers in (asked["trained"], asked["played"]):  # costs are negative weights
        np.testing.assert_array_equal(numbers["reward_weights.dispatches"], [0.0, -20.0, 0.0])
        np.testing.assert_allclose(numbers["reward_weights.gas_delay"], [0.0, 0.0, -0.1], rtol=1e-6)
    assert "100 decisions of each learner" in capsys.readouterr().out


def test_ticks(monkeypatch):
    """Each rule's change is from its own scores at the first tick."""
    given = {(0.25, "none"): 1.0, (0.25, "paced"): 10.0, (0.5, "none"): 3.0, (0.5, "paced"): 50.0}

    def play(scenario, tick_s, episodes, seed):
        return {name: scores_of(given[tick_s, name], ticks.COLUMNS) for name in ("none", "paced")}

    monkeypatch.setattr(ticks, "RULES", ("none", "paced"))
    monkeypatch.setattr(ticks, "play", play)
    rows = ticks.measure(options(ticks=[0.25, 0.5]))["rows"]
    assert [(row["policy"], row["value"], row["return"], row["return_change"]) for row in rows] == [
        ("none", 0.25, 1.0, 0.0),
        ("none", 0.5, 3.0, 2.0),
        ("paced", 0.25, 10.0, 0.0),
        ("paced", 0.5, 50.0, 40.0),
    ]


def test_the_best_of_a_grid(monkeypatch, capsys):
    """Its settings are those of its own row."""
    returns = {"ramp 1, interval_s 24": 5.0, "ramp 2, interval_s 24": 7.0}
    monkeypatch.setitem(tune.GRID, "paced", [{"ramp": n, "interval_s": 24} for n in (1, 2)])
    monkeypatch.setitem(tune.RULES, "paced", lambda env, **row: row)

    def evaluate(env, params, policies, episodes, seed, batch):
        return {name: {"return": returns[name] + np.array([-1.0, 0.0, 1.0])} for name in policies}

    monkeypatch.setattr(tune, "evaluate_policies", evaluate)
    report = tune.play_grid(None, None, "paced", options())
    assert [(row["ramp"], row["return_mean"]) for row in report["rows"]] == [(1, 5.0), (2, 7.0)]
    assert report["best"] == report["rows"][1]
    assert capsys.readouterr().out.splitlines()[-1] == "best paced: ramp 2, interval_s 24"


def test_calibrate(monkeypatch, capsys):
    """Weights from the asked seed's episodes, and Table 2 from those of the next."""
    own = {"depleted": -4.0, "soc": 2.0, "speed": 0.5, "unused": 0.0}
    params = SimpleNamespace(reward_weights=own)
    monkeypatch.setattr(calibrate.medjax, "make", lambda scenario: (None, params))
    monkeypatch.setattr(calibrate, "rules", lambda env, names: dict.fromkeys(names))
    depleted = {"none": 100.0, "random": 70.0}

    def score(name, seed):
        """Under twice the other weights and w1 = 9, means are the paper's with the seed 5; then 10 a seed more."""
        mean, _ = calibrate.TABLE_2[name]
        rest = (
            (mean + 9.0 * depleted[name]) / 2.0 if seed == 5 else mean + 4.0 * depleted[name] + 10.0
        )
        values = rest - 4.0 * depleted[name] + np.array([-1.0, 0.0, 1.0])
        return {"return": values, "evs_depleted": np.full(EPISODES, depleted[name])}

    play = lambda policies, seed: {name: score(name, seed) for name in policies}  # noqa: E731
    monkeypatch.setattr(calibrate, "Evaluation", lambda *given: SimpleNamespace(play=play))
    report = calibrate.measure(options(seed=5))
    assert report["weights"] == pytest.approx({"depleted": -9.0, "soc": 4.0, "speed": 1.0})
    for row in report["table_2"]:
        mean, std = calibrate.TABLE_2[row["policy"]]
        assert (row["paper_mean"], row["std"]) == (mean, 1.0)
        assert row["mean"] == pytest.approx(mean + 10.0)
        assert row["deviations_apart"] == pytest.approx(10.0 / std)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["soc", "4.0000", "2.0000"] in lines


def test_planner(monkeypatch, capsys):
    """Gains of an episode's choices add up; only states that were left count as such."""
    left = [planner.PlanChoice(2, 3.0, 6.0), planner.PlanChoice(0, 5.0, 8.0)]
    stays = planner.PlanChoice(planner.AS_BASE, 0.0, np.nan)
    played = planner.Played(
        np.array([20.0, 30.0]), np.array([11.0, 29.0]), [[*left, stays], [stays]]
    )
    asked = []
    config = SimpleNamespace(agents="none", scenario="paper", algorithm="ppo")
    monkeypatch.setattr(planner, "dispatcher_settings", lambda options: config)
    policies = {"budgeted": "B", "paced": "P"}
    monkeypatch.setattr(planner, "load", lambda options, config: (None, None, policies))
    monkeypatch.setattr(planner, "play", lambda *given: asked.append(given[2]) or played)
    given = {"episodes": 2, "run_dir": None, "know_arrivals": False}
    report = planner.measure(options(**given, base="paced"))
    assert planner.measure(options(**given, base=None))["policy"] == "budgeted"
    assert (report["policy"], asked) == ("paced", ["P", "B"])
    assert (report["asked"], report["left"]) == (2.0, 1.0)
    assert report["spread"] == pytest.approx(50.0**0.5)  # root of the mean of 36 and 64
    assert (report["gain_mean"], report["apart_mean"]) == (4.0, 5.0)
    lines = capsys.readouterr().out.splitlines()
    assert "asked at 2.0 states an episode, the planner leaves paced at 1.0" in lines[0]
    assert "by its choices, in futures that did not make them: 4.00 [" in lines[1]
    assert "by whole episodes: 5.00 [" in lines[2]


def test_generalization(monkeypatch):
    """Each world has its own demand, and differences are from the rule that names them."""

    def play(policies, seed, params):
        noise = np.array([-1.0, 0.0, 1.0])
        gains = {"mine": 7.0, "budgeted": 5.0, "none": 0.0}
        return {name: {"return": params * gains[name] + noise} for name in policies}

    for name, stub in {
        "medjax": SimpleNamespace(make=lambda scenario, **sizes: (None, 100.0)),
        "rules": lambda env: {"budgeted": None, "none": None},
        "Evaluation": lambda *given: SimpleNamespace(play=play),
        "scale_demand": lambda params, factor: params * factor,
        "summarize": lambda scores, *given: {"policies": [*scores]},
    }.items():
        monkeypatch.setattr(generalization, name, stub)
    worlds = generalization.play("paper", {"half": 0.5, "twice": 2.0}, {"mine": None}, EPISODES, 0)
    for world, factor in (("half", 50.0), ("twice", 200.0)):
        found = worlds[world]
        assert found["policies"] == ["mine", "budgeted", "none"]
        means = {
            rule: {name: each["mean"] for name, each in found[f"minus_{rule}"].items()}
            for rule in ("budgeted", "none")
        }
        assert means == {
            "budgeted": {"mine": 2.0 * factor, "none": -5.0 * factor},
            "none": {"mine": 7.0 * factor, "budgeted": 5.0 * factor},
        }
