"""The planner plays the episodes of the evaluation, and finds what pays."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks import planner
from medjax.policies import look_ahead, none
from tests.benchmarks.refusal import refused
from train.evaluation import baseline, evaluate_policies

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}


@pytest.mark.parametrize(("pay", "sends"), [(1e4, True), (-1e4, False)])
def test_takes_the_action_whose_future_is_best(pay, sends):
    """With a price on each MED that outweighs all else, it sends one, or none."""
    env, params = medjax.make("paper", **SMALL)
    params = params.replace(reward_weights={**params.reward_weights, "dispatches": pay})
    _, state = env.reset(jax.random.key(0), params)
    act = jax.jit(look_ahead(env, none(env), samples=2, horizon_s=3.0))
    assert (int(act(jax.random.key(1), state, params)) > 0) == sends


def test_a_masked_action_is_never_taken():
    """Under a cooldown it waits, however well a MED would pay."""
    env, params = medjax.make("paper", **SMALL)
    params = params.replace(reward_weights={**params.reward_weights, "dispatches": 1e4})
    _, state = env.reset(jax.random.key(0), params)
    state = state.replace(cooldown_s=jnp.float32(5.0))
    act = look_ahead(env, none(env), samples=1, horizon_s=8.0)
    assert int(act(jax.random.key(1), state, params)) == 0


@pytest.mark.parametrize("interval", [1, 3])
def test_plays_the_episodes_of_the_evaluation(interval):
    """A rule that never sends is scored as train.evaluation scores it, to rounding."""
    env, params = medjax.make("paper", **SMALL)
    ours = planner.play_now_and_then(env, params, none(env), interval, episodes=4, seed=3)
    theirs = evaluate_policies(env, params, {"none": baseline(none(env))}, 4, seed=3)["none"]
    for name, values in ours.items():
        np.testing.assert_allclose(values, theirs[name], rtol=1e-5, atol=1e-5, err_msg=name)


def test_command(tmp_path, capsys):
    """A table and the same figures as JSON."""
    out = tmp_path / "out.json"
    argv = ["--episodes=2", "--samples=1", "--horizon=4", "--interval=200", f"--json={out}"]
    planner.main(argv)
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert set(report["policies"]) == {"planner", "paced", "none"}
    assert f"planner minus paced: {report['planner_minus_base']['mean']:.1f}" in printed
    for name, row in report["policies"].items():
        assert any(
            line.startswith(name) and f"{row['return']:.1f}" in line for line in printed.split("\n")
        )


@pytest.mark.parametrize("argv", [["--samples=0"], ["--base=best"], ["--interval=0"]])
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(planner.main, argv, capsys)
