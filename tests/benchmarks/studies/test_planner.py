"""The planner plays the episodes of the evaluation, and finds what pays."""

import json
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import planner
from medjax.episodes.scores import evaluate_policies
from medjax.policies.planner import AS_BASE, look_ahead
from medjax.policies.rules import none, random
from medjax.traffic.arrivals import redraw
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}


@pytest.fixture(scope="module")
def highway(quick_compiles):
    """A small environment, its numbers, a state, and what looks ahead from it by the name of its base."""
    env, params = medjax.make("paper", **SMALL)
    plans = {
        base: jax.jit(look_ahead(env, base(env), samples=2, hold=20)) for base in (none, random)
    }
    return params, jax.jit(env.reset)(jax.random.key(0), params)[1], plans


def paid(params, pay):
    """Numbers that pay so much for each MED that all else is outweighed."""
    return params.replace(reward_weights={**params.reward_weights, "dispatches": jnp.float32(pay)})


@pytest.mark.parametrize(
    ("base", "pay", "allowed"),
    [
        (none, 1e4, {1, 2, 3, 4}),  # sends, since the base would not
        (none, -1e4, {AS_BASE}),  # nothing is better than to wait, as the base does
        (random, -1e4, {0}),  # waits to the end, since the base would not
    ],
)
def test_leaves_the_base_for_what_surely_pays(highway, base, pay, allowed):
    params, state, plans = highway
    assert int(plans[base](jax.random.key(1), state, paid(params, pay))) in allowed


def test_no_gain_is_no_reason(highway):
    """Where all returns are alike it stays with the base."""
    params, state, plans = highway
    params = params.replace(reward_weights=dict.fromkeys(params.reward_weights, jnp.float32(0.0)))
    assert int(plans[none](jax.random.key(1), state, params)) == AS_BASE


def test_a_masked_action_is_never_taken(highway):
    """Under a cooldown it cannot send, however well a MED would pay."""
    params, state, plans = highway
    state = state.replace(cooldown_s=jnp.float32(5.0))
    assert int(plans[none](jax.random.key(1), state, paid(params, 1e4))) == AS_BASE


def test_does_not_know_who_will_come(highway):
    """Of two states that differ in the seed of what arrives alone it says the same, by accident or not."""
    params, state, plans = highway
    other = redraw(jax.random.key(9), state)
    assert not np.array_equal(other.arrivals, state.arrivals)
    keys = jax.random.split(jax.random.key(1), 24)
    said = [[int(plans[none](key, seen, params)) for key in keys] for seen in (state, other)]
    assert said[0] == said[1]
    # Two futures are few: accidents there are, and they are of the key.
    assert len(set(said[0])) > 1


@pytest.mark.parametrize("hold", [1, 3])
@pytest.mark.slow
@pytest.mark.parametrize("plan", [AS_BASE, 0])
def test_plays_the_episodes_of_the_evaluation(hold, plan):
    """The base rule itself, and nothing at all, are scored as medjax.episodes.scores scores them, to rounding."""
    env, params = medjax.make("paper", **SMALL)
    always = lambda key, state, params: jnp.int32(plan)  # noqa: E731
    ours = planner.play_plans(env, params, always, random(env), hold, episodes=4, seed=3)
    rule = random(env) if plan == AS_BASE else none(env)
    theirs = evaluate_policies(env, params, {"rule": rule}, 4, seed=3)["rule"]
    assert (theirs["meds_dispatched"].sum() > 0) == (plan == AS_BASE)
    for name, values in ours.items():
        np.testing.assert_allclose(values, theirs[name], rtol=1e-5, atol=1e-5, err_msg=name)


@pytest.mark.slow
def test_command(tmp_path, capsys, monkeypatch):
    """A table and the same figures as JSON."""
    monkeypatch.setattr(medjax, "make", partial(medjax.make, **SMALL))
    out = tmp_path / "out.json"
    planner.main(["--episodes=2", "--samples=2", "--hold=8", "--base=paced", f"--json={out}"])
    report = json.loads(out.read_text())
    printed = capsys.readouterr().out
    assert set(report["policies"]) == {"planner", "paced", "slow", "none"}
    assert f"planner minus paced: {report['planner_minus_base']['mean']:.1f}" in printed
    for name, row in report["policies"].items():
        (line,) = [line for line in printed.split("\n") if line.startswith(f"{name}  ")]
        assert f"{row['return']:.1f}" in line


@pytest.mark.parametrize(
    "argv", [["--samples=1"], ["--base=best"], ["--hold=0"], ["--run-dir=no/such"]]
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(planner.main, argv, capsys)
