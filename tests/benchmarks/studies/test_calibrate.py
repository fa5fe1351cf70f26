"""The weights that `benchmarks.studies.calibrate` finds, and the paper's Table 2 with those of the preset."""

import json

import numpy as np
import pytest

import medjax
from benchmarks.studies import calibrate
from benchmarks.studies.calibrate import TABLE_2, compare, solve, without_penalty
from medjax.episodes.scores import evaluate_policies
from tests.benchmarks.refusal import refused


def test_recovers_known_weights():
    """Whatever penalty the episodes were played under."""
    rng = np.random.default_rng(0)
    factor, w1, penalty = 1.7, 9.0, 4.0
    scores = {}
    for name, (mean, _) in TABLE_2.items():
        depleted = rng.poisson(100 if name == "none" else 70, 50).astype(float)
        # What the other terms must have given for the mean return to be the paper's.
        rest = (mean + w1 * depleted.mean()) / factor + rng.normal(0.0, 5.0, 50)
        rest += (mean + w1 * depleted.mean()) / factor - rest.mean()
        scores[name] = {"return": rest - penalty * depleted, "evs_depleted": depleted}
        np.testing.assert_allclose(without_penalty(scores[name], penalty), rest, rtol=1e-12)
    np.testing.assert_allclose(solve(scores, penalty), (factor, w1), rtol=1e-9)


@pytest.mark.slow
def test_the_preset_reproduces_table_2():
    """Within one of the paper's deviations and the error of so few episodes; PPO is not asked."""
    env, params = medjax.make("paper")
    policies = {name: medjax.BASELINES[name](env) for name in TABLE_2}
    for row in compare(evaluate_policies(env, params, policies, 64, seed=11)):
        error = row["std"] / np.sqrt(64)
        assert abs(row["mean"] - row["paper_mean"]) < row["paper_std"] + 2 * error, row


@pytest.mark.slow
def test_command_reports_what_it_prints(tmp_path, capsys):
    """Weights and both policies, in print and in the file."""
    out = tmp_path / "out.json"
    calibrate.main(["--episodes=4", f"--json={out}"])
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert set(report["weights"]) == {"depleted", "soc", "distance", "speed"}
    assert report["weights"]["depleted"] < 0.0 < report["weights"]["soc"]
    for row in report["table_2"]:
        assert f"{row['mean']:.1f}" in printed


@pytest.mark.parametrize(
    "argv", [["--episodes=0"], ["--seed=-1"], ["--scenario=nowhere"], ["--scenario=corridor"]]
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(calibrate.main, argv, capsys)
