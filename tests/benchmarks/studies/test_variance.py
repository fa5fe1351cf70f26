"""What the spread of returns is made of: told apart as known numbers say, in episodes that evaluation plays, too."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import variance
from medjax.episodes.scores import evaluate_policies
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}


def test_variance_is_shared_out_as_by_hand():
    """Demands with means 2 and 6, each with a variance of 2: 8 - 2 / 2 is demand's, of 7 + 2."""
    values = np.array([[[1.0, 3.0], [5.0, 7.0]]])
    assert variance.within(values) == pytest.approx([2.0])
    assert variance.demands_share(values) == pytest.approx([7.0 / 9.0])


def test_the_share_of_numbers_drawn_with_a_known_one():
    """Variances of 4 and 1; means over the streams alone would say 0.81 + 0.01."""
    rng = np.random.default_rng(0)
    values = 2.0 * rng.normal(size=(1, 20_000, 1)) + rng.normal(size=(1, 20_000, 4))
    assert variance.demands_share(values) == pytest.approx([0.8], abs=0.01)


def test_correlations_are_numpys():
    """All at once, and of what is left without each demand's mean."""
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(5, 7, 1))
    pairs = rng.normal(size=(5, 1, 2)) + noise + rng.normal(size=(5, 7, 2))
    found = variance.correlation(pairs[None])
    assert found == pytest.approx([np.corrcoef(pairs[..., 0].ravel(), pairs[..., 1].ravel())[0, 1]])
    rest = (pairs - pairs.mean(axis=1, keepdims=True)).reshape(-1, 2)
    expected = np.corrcoef(rest[:, 0], rest[:, 1])[0, 1]
    assert variance.correlation_within(pairs[None]) == pytest.approx([expected])


@pytest.fixture(scope="module")
def played():
    """EVs that all come without the charge for their way, two demands in three streams."""
    soc = {"arrival_soc_low": 0.001, "arrival_soc_high": 0.002}
    env, params = variance.make(**SMALL, **soc)
    policies = {name: medjax.BASELINES[name](env) for name in ("none", "greedy")}
    return env, params, policies, variance.play(env, params, policies, (2, 3), 0)


def test_the_first_stream_of_a_demand_is_an_episode_of_evaluation(played):
    """Demand 1 begins as episode 3 of the seed; other streams return something else."""
    env, params, policies, found = played
    weights = {**params.reward_weights, "came_needy": jnp.float32(0.0)}
    plain = params.replace(reward_weights=weights)
    scores = evaluate_policies(env, plain, policies, 4, 0)
    for name, (returns, _) in found.items():
        expected = scores[name]["return"][[0, 3]]
        np.testing.assert_allclose(returns[:, 0], expected, rtol=1e-5, atol=1e-4)
        assert len(np.unique(returns)) == returns.size


def test_all_who_come_without_charge_are_counted(played):
    """As many as the environment counts EVs, the same at one demand but for who is delayed by the end."""
    env, params, policies, found = played
    scores = evaluate_policies(env, params, policies, 4, 0)
    for name, (_, came) in found.items():
        np.testing.assert_array_equal(came[:, 0], scores[name]["evs_entered"][[0, 3]])
        assert came.min() > 0.0


def test_nobody_with_charge_is_counted():
    """A full pack is enough for the whole road."""
    soc = {"arrival_soc_low": 0.999, "arrival_soc_high": 1.0, "battery_scale": 1.0}
    env, params = variance.make(**SMALL, **soc)
    ((_, came),) = variance.play(
        env, params, {"none": medjax.BASELINES["none"](env)}, (2, 1), 0
    ).values()
    assert not came.any()


def test_relief_takes_away_what_arrivals_bring():
    """Returns that are what EVs in need cost, and noise: the noise is left."""
    rng = np.random.default_rng(2)
    came, noise = rng.poisson(50.0, size=(400, 5)).astype(float), rng.normal(size=(400, 5))
    row = variance.describe(noise - 8.0 * came, came, -8.0, 0)
    assert row["relief_spread"] == pytest.approx(noise.std())
    assert row["best_weight"] == pytest.approx(-8.0, abs=0.02)
    assert row["spread"] > 50.0


@pytest.mark.slow
def test_the_command_prints_each_policy(tmp_path, capsys):
    """And writes the same figures."""
    out = tmp_path / "out.json"
    variance.main(["--demands=2", "--streams=2", f"--json={out}"])
    rows = json.loads(out.read_text())["policies"]
    printed = capsys.readouterr().out
    assert set(rows) == {"pretrained", "budgeted", "forecast", "none"}
    assert all(name in printed for name in rows)


@pytest.mark.parametrize("argv", [["--demands=1"], ["--streams=0"], ["--seed=-1"]])
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(variance.main, argv, capsys)
