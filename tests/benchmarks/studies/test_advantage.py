"""What leaving a policy pays is found where it is known, and nothing is found where there is nothing."""

import json
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import advantage
from medjax.episodes.keys import episode_keys
from medjax.episodes.player import Player
from medjax.policies.planner import AS_BASE
from medjax.policies.rules import none
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 2, "num_evs": 6, "num_gas": 12, "episode_decisions": 20}
HOLD, ROWS = 5, 12


def futures_of(pay):
    """Environment, futures of a policy that never sends where a MED pays so much, and an episode's first state."""
    env, params = medjax.make("paper", **SMALL)
    # Nothing else pays where a MED does not.
    others = (
        params.reward_weights if pay else dict.fromkeys(params.reward_weights, jnp.float32(0.0))
    )
    params = params.replace(reward_weights={**others, "dispatches": jnp.float32(pay)})
    played = Player(env, [none(env)]).start(episode_keys(0, 1), params)
    one = jax.tree.map(lambda leaf: leaf[0], played)
    return env, advantage.Futures(env, params, none(env), HOLD, ROWS), one


def test_what_pays_is_found_and_what_it_pays():
    """A MED that pays 1e4 is sent, and pays that: the rest of eq (10) is below 100 in twenty seconds."""
    env, futures, state = futures_of(1e4)
    found = futures.find(jax.random.key(1), state, 0, env.num_actions)
    assert found.left
    assert found.gain == pytest.approx(1e4, abs=100.0)
    assert found.spread < 100.0


@pytest.mark.parametrize("pay", [-1e4, 0.0])
def test_what_does_not_pay_is_left_alone(pay):
    """The policy goes on where sending costs, and where all returns are alike."""
    env, futures, state = futures_of(pay)
    found = futures.find(jax.random.key(1), state, 0, env.num_actions)
    assert not found.left
    assert found.gain == 0.0


def test_candidates_meet_the_same_futures():
    """Two that do the same have equal returns in every future; futures differ."""
    _, futures, state = futures_of(1.0)
    returns = futures.returns(jax.random.key(1), state, 0, [AS_BASE, 0, AS_BASE])
    assert returns.shape == (ROWS // 3, 3)
    np.testing.assert_array_equal(returns[:, 0], returns[:, 2])
    np.testing.assert_array_equal(returns[:, 0], returns[:, 1])  # a policy that waits, waits
    assert len(set(returns[:, 0])) > 1


@pytest.mark.slow
def test_command(tmp_path, capsys, monkeypatch):
    """Its lines and the same figures as JSON."""
    monkeypatch.setattr(medjax, "make", partial(medjax.make, **SMALL))
    out = tmp_path / "out.json"
    advantage.main(["--episodes=2", "--futures=12", "--hold=10", "--base=paced", f"--json={out}"])
    report, printed = json.loads(out.read_text()), capsys.readouterr().out
    assert f"pays {report['gain_mean']:.2f} [" in printed
    assert report["policy"] == "paced"


@pytest.mark.parametrize(
    "argv", [["--futures=1"], ["--base=best"], ["--hold=0"], ["--run-dir=no/such"]]
)
def test_bad_input_is_one_line(argv, capsys):
    """Exit code 2, and the value is named."""
    assert argv[0].split("=")[1] in refused(advantage.main, argv, capsys)
