"""The command reports every setting and the best of each rule; the climb finds known tops."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import tune
from benchmarks.studies.tune import (
    GROUP,
    Responses,
    directions,
    fit,
    numbers_of,
    step_to_top,
)
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import Budget, budgeted
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.mark.slow
def test_best_is_the_highest_return(tmp_path, monkeypatch, capsys):
    """One line a setting; rules that send MEDs beat the same ones told to send hardly any."""
    grid = {
        "paced": [{"ramp": 1, "interval_s": 30}, {"ramp": 1, "interval_s": 10_000}],
        "forecast": [{"window_s": 60, "enough": 1000.0}, {"window_s": 60, "enough": 4.0}],
    }
    monkeypatch.setattr(tune, "GRID", grid)
    out = tmp_path / "out.json"
    tune.main(["--episodes=4", "--rules", "paced", "forecast", f"--json={out}"])
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert report["paced"]["best"] == report["paced"]["rows"][0]
    assert report["forecast"]["best"] == report["forecast"]["rows"][1]
    assert "best paced: ramp 1, interval_s 30" in printed
    assert "best forecast: window_s 60, enough 4" in printed
    for row in (*report["paced"]["rows"], *report["forecast"]["rows"]):
        assert f"{row['return_mean']:.1f}" in printed
        assert row["return_ci95"][0] <= row["return_mean"] <= row["return_ci95"][1]


@pytest.mark.slow
def test_climbs_to_a_surely_better_rule(tmp_path, capsys):
    """From the numbers of `forecast`, on episodes of its own, in a few rounds."""
    out = tmp_path / "out.json"
    tune.main(["--rules=budgeted", "--rounds=6", "--episodes=256", f"--json={out}"])
    found = json.loads(out.read_text())["budgeted"]
    assert len(found["rounds"]) == 6
    assert 0.0 < found["gain_ci95"][0] < found["gain_mean"] < found["gain_ci95"][1]
    printed = capsys.readouterr().out
    assert "budgeted: round  6" in printed
    assert "ramp 4 " in printed
    assert f"gains on forecast {found['gain_mean']:.1f}" in printed


@pytest.mark.parametrize(
    "argv",
    [
        ["--episodes=1"],
        ["--rounds=0"],
        ["--groups=no"],
        ["--groups=7"],
        ["--rules=best"],
        ["--scenario=nowhere"],
        ["--set=size=99"],
    ],
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(tune.main, argv, capsys)


def test_directions_are_opposite_and_standard_normal():
    steps = directions(np.random.default_rng(0), groups=200, size=3)
    assert steps.shape == (200, GROUP, 3)
    half = GROUP // 2
    np.testing.assert_array_equal(steps[:, :half], -steps[:, half:])
    np.testing.assert_allclose(steps.std(axis=(0, 1)), 1.0, atol=0.05)


def test_finds_the_top_under_noise_and_luck_of_the_group():
    """Three numbers that interact; what a group has in common is a hundred times what they are worth."""
    rng, top = np.random.default_rng(1), np.array([0.5, -0.3, 0.2])
    bend = np.array([[9.0, 3.0, 0], [3.0, 8.0, 1.0], [0, 1.0, 7.0]])
    steps = directions(rng, groups=200, size=3)
    away = steps - top
    returns = -0.5 * np.einsum("gki,ij,gkj->gk", away, bend, away)
    returns += 300.0 * rng.standard_normal((200, 1)) + rng.standard_normal(returns.shape)
    slope, curvature, error = fit(steps, returns)
    np.testing.assert_allclose(curvature, -bend, atol=0.3)
    assert (np.abs(slope - bend @ top) < 4.0 * error).all()
    assert (error < 0.1).all()
    np.testing.assert_allclose(step_to_top(slope, curvature), top, atol=0.05)


def test_without_a_top_the_step_is_bounded():
    step = step_to_top(np.array([100.0, -50.0]), np.array([[5.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(step, [1.0, -0.5])


@pytest.mark.thorough
def test_returns_are_those_of_the_evaluation():
    """Each variant's numbers give what the rule with these numbers scores on that episode."""
    env, params = medjax.make("paper", episode_decisions=40)
    rules = [Budget(), Budget(ramp=(9.0,) * 4)]
    responses = Responses(env, params, 2 * GROUP)
    rows = np.stack([numbers_of(rule) for rule in rules])
    returns = responses.of(np.broadcast_to(np.tile(rows, (GROUP // 2, 1)), (2, GROUP, 9)), seed=3)
    policies = {str(number): budgeted(env, rule) for number, rule in enumerate(rules)}
    scores = evaluate_policies(env, params, policies, episodes=2, seed=3)
    for number in range(2):
        expected = np.repeat(scores[str(number)]["return"][:, None], GROUP // 2, axis=1)
        np.testing.assert_allclose(returns[:, number::2], expected, atol=0.05)
    assert not np.allclose(returns[:, 0], returns[:, 1])
    found = responses.weights_of(jnp.asarray(rows[1], jnp.float32))
    np.testing.assert_array_equal(jnp.stack(found.ramp), 9.0)
