"""The planner finds choices whose gain is known, and their gains add up to that of the episode."""

import json
from argparse import Namespace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import planner
from benchmarks.studies.planner import AS_BASE
from medjax.episodes.keys import episode_keys
from medjax.episodes.scores import evaluate_policies
from medjax.policies.rules import none, paced
from tests.benchmarks.refusal import refused
from train.algorithms.ppo.settings import PPOConfig
from train.runs.run_directory import RunDir

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}
HOLD, ROWS = 5, 12
OPTIONS = Namespace(hold=HOLD, episodes=2, futures=ROWS, seed=0, know_arrivals=False)


def paying(pay, **numbers):
    """A world in which a MED that is sent pays so much, or nothing does anything."""
    env, params = medjax.make("paper", **SMALL, **numbers)
    # Nothing else pays where a MED does not.
    others = (
        params.reward_weights if pay else dict.fromkeys(params.reward_weights, jnp.float32(0.0))
    )
    return env, params.replace(reward_weights={**others, "dispatches": jnp.float32(pay)})


@pytest.fixture(scope="module")
def futures():
    """Futures of a policy that never sends."""
    env, params = paying(1.0)
    return planner.Rollouts(env, params, none(env), HOLD, ROWS)


@pytest.fixture(scope="module")
def state(futures):
    """An episode's first state."""
    played = jax.jit(futures.runner.start)(episode_keys(0, 1), futures.same[1])
    return jax.tree.map(lambda leaf: leaf[0], played)


def find(futures, state, pay):
    """What the planner finds where a MED pays so much."""
    env, params = paying(pay)
    futures.same = futures.same[0], params
    return futures.select_plan(jax.random.key(1), state, 0, env.num_actions)


@pytest.mark.thorough
def test_finds_a_choice_that_pays_and_its_gain(futures, state):
    """A MED that pays 1e4 is sent, and pays that: the rest of eq (10) is below 100 in twenty seconds."""
    found = find(futures, state, 1e4)
    assert found.plan > 0
    assert found.gain == pytest.approx(1e4, abs=100.0)
    assert found.gain_std < 100.0


@pytest.mark.thorough
@pytest.mark.parametrize("pay", [-1e4, 0.0])
def test_leaves_the_policy_only_where_that_pays(futures, state, pay):
    """The policy goes on where sending costs, and where all returns are alike."""
    found = find(futures, state, pay)
    assert (found.plan, found.gain) == (AS_BASE, 0.0)


@pytest.mark.thorough
def test_candidates_meet_the_same_futures(futures, state):
    """Equal candidates have equal returns in every future; futures differ."""
    futures.same = futures.same[0], paying(1.0)[1]
    returns = futures.returns(jax.random.key(1), state, 0, [AS_BASE, 0, AS_BASE])
    assert returns.shape == (ROWS // 3, 3)
    np.testing.assert_array_equal(returns[:, 0], returns[:, 2])
    np.testing.assert_array_equal(returns[:, 0], returns[:, 1])  # a policy that waits, waits
    assert len(set(returns[:, 0])) > 1


@pytest.mark.thorough
@pytest.mark.parametrize("known", [False, True])
def test_futures_keep_the_arrivals_only_of_a_planner_who_knows_them(state, known):
    """Without `--know-arrivals` every future has arrivals of its own; drivers differ either way."""
    env, params = paying(1.0)
    futures = planner.Rollouts(env, params, none(env), HOLD, ROWS, know_arrivals=known)
    played = futures._branch(jax.random.key(1), state, jnp.arange(ROWS), params)
    arrivals = jax.random.key_data(played.state.arrivals).reshape(ROWS, -1)
    own = jax.random.key_data(state.state.arrivals).ravel()
    assert len({tuple(row) for row in np.asarray(arrivals)}) == (1 if known else ROWS)
    assert (np.asarray(arrivals) == np.asarray(own)).all() == known
    returns = futures.returns(jax.random.key(1), state, 0, [AS_BASE])
    assert len(set(returns[:, 0])) > 1


@pytest.mark.thorough
def test_futures_keep_surges_that_have_begun():
    """By the parameters that are given, not by those for which the program was traced."""
    env, params = paying(1.0, num_surges=2, surge_until_s=20.0)
    futures = planner.Rollouts(env, params, none(env), HOLD, ROWS)
    played = jax.jit(futures.runner.start)(episode_keys(0, 1), params)
    state = jax.tree.map(lambda leaf: leaf[0], played)
    surges = jnp.array([[0.2, 0.5], [0.8, 0.5]])  # at 4 s and at 16 s
    state = state.replace(state=state.state.replace(surges=surges, time=jnp.int32(10)))
    later = params.replace(demand=params.demand.replace(surge_from_s=jnp.float32(15.0)))
    for given, begun in ((params, 1), (later, 0)):
        anew = futures._branch(jax.random.key(1), state, jnp.arange(ROWS), given).state.surges
        assert (anew[:, :begun] == surges[:begun]).all()
        assert len({float(draw) for draw in anew[:, begun:, 1].ravel()}) == ROWS * (2 - begun)


@pytest.mark.thorough
def test_gains_of_choices_add_up_to_that_of_the_episode():
    """The planner sends both MEDs, in two of the four states in which the policy, which sends none, could be left."""
    env, params = paying(1e4, cooldown_s=HOLD - 1.0)
    played = planner.play(env, params, none(env), OPTIONS)
    for states, ours, theirs in zip(
        played.choices, played.returns, played.policy_returns, strict=True
    ):
        assert sum(each.gain for each in states) == pytest.approx(2e4, abs=200.0)
        assert ours - theirs == pytest.approx(2e4, abs=200.0)
        assert [each.plan > 0 for each in states] == [True, True]  # then none is at the depot


@pytest.mark.thorough
def test_plays_the_policys_episodes_where_nothing_pays():
    """The policy sends MEDs, and leaving it never gains."""
    env, params = paying(0.0)
    played = planner.play(env, params, paced(env), OPTIONS)
    assert {each.plan for states in played.choices for each in states} == {AS_BASE}
    np.testing.assert_array_equal(played.returns, played.policy_returns)


@pytest.mark.slow
def test_the_policy_alone_scores_as_in_an_evaluation():
    """To rounding, on the episodes of `train.evaluate`."""
    env, params = paying(-1.0)
    alone = planner.play(env, params, paced(env), OPTIONS).policy_returns
    theirs = evaluate_policies(env, params, {"it": paced(env)}, 2, seed=0)["it"]["return"]
    np.testing.assert_allclose(alone, theirs, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_command(tmp_path, capsys, monkeypatch):
    """Its lines and the same figures as JSON."""
    monkeypatch.setattr(medjax, "make", partial(medjax.make, **SMALL))
    out = tmp_path / "out.json"
    planner.main(["--episodes=2", "--futures=12", "--hold=10", "--base=paced", f"--json={out}"])
    report, printed = json.loads(out.read_text()), capsys.readouterr().out
    assert (
        f"by its choices, in futures that did not make them: {report['gain_mean']:.2f} [" in printed
    )
    assert f"by whole episodes: {report['apart_mean']:.2f} [" in printed
    assert report["policy"] == "paced"


@pytest.mark.parametrize(
    "argv", [["--futures=1"], ["--base=best"], ["--hold=0"], ["--run-dir=no/such"]]
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(planner.main, argv, capsys)


def test_a_run_of_agents_is_refused(tmp_path, capsys):
    """The planner needs a dispatcher."""
    run = RunDir(tmp_path / "run")
    run.claim(PPOConfig(agents="ippo")).close()
    assert "is of agents, allowed: of a dispatcher" in refused(
        planner.main, [f"--run-dir={run.path}"], capsys
    )
