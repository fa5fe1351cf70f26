"""What agents are seen to do, with policies of which it is known."""

import errno
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from benchmarks.studies import agents
from medjax.env.agents.actions import Parts
from medjax.policies.policy import Choice, Policy
from tests.benchmarks.refusal import refused

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {
    "size": 4,
    "num_meds": 4,
    "num_evs": 12,
    "num_gas": 12,
    "mainline_per_h": 900.0,
    "ev_share": 0.6,
    "episode_decisions": 60,
    "cooldown_s": 0.0,
    "speeds": (14.0, 22.0),
}


def told(env, speed, accept):
    """Everyone enters as soon as it may, and then drives so fast and takes EVs, or none."""

    def act(weights, key, obs, state, params):
        mask = env.action_mask(state, params)
        usual = env.actions.by_rule(state, params)
        parts = usual._replace(
            speed=jnp.full_like(usual.speed, speed), accept=jnp.full_like(usual.accept, accept)
        )
        action = env.actions.fold(Parts(*parts), jnp.ones(env.num_agents, bool))
        usual_speed = parts._replace(speed=usual.speed)  # of one that only merges
        merging = env.actions.fold(Parts(*usual_speed), jnp.ones(env.num_agents, bool))
        rows = jnp.arange(env.num_agents)
        action = jnp.where(mask[rows, action], action, merging)
        action = jnp.where(mask[rows, action], action, jnp.where(mask[:, 1], 1, 0))
        return Choice(action, jnp.zeros((env.num_agents, env.num_actions)))

    return Policy(act)


@pytest.fixture(scope="module")
def named():
    return medjax.make_agents("paper", **SMALL)


@pytest.mark.parametrize(("speed", "accept"), [(0, 1), (1, 0)])
def test_what_they_are_told_is_what_is_seen(named, speed, accept):
    """One speed wherever EVs are, and all who ask are taken, or none."""
    policy = told(named.env, speed, accept)
    seen, _ = agents.watch(named.env, named.params, policy, episodes=2, seed=0)
    assert seen.decisions.sum() > 20
    there = seen.decisions > 0
    np.testing.assert_allclose(
        seen.told_m_per_s[there] / seen.decisions[there], SMALL["speeds"][speed], rtol=1e-6
    )
    assert seen.asked.sum() > 0
    np.testing.assert_array_equal(seen.taken, accept * seen.asked)


def test_a_picture_is_written_in_full_or_not_at_all(tmp_path, monkeypatch):
    """As on a full disk, and over one that is there."""
    result = {
        "speeds": [14.0, 22.0],
        "gap_m": [-25.0, 25.0],
        "decisions": [1.0, 0.0, 2.0],
        "told_m_per_s": [14.0, 0.0, 22.0],
        "lacks_packs": ["nothing", "over 1"],
        "taken_share": [0.5, 1.0],
    }
    path = tmp_path / "agents.png"
    agents.draw(path, result)
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")

    def full(self, file, **_):
        Path(file).write_bytes(b"half")
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(OSError, match="full"):
        agents.draw(path, result)
    assert [file.name for file in tmp_path.iterdir()] == ["agents.png"]
    assert path.read_bytes() == before


def test_bad_input_is_one_line(tmp_path, capsys):
    assert "--policy" in refused(agents.main, [], capsys)
    missing = str(tmp_path / "none.zip")
    assert "none.zip" in refused(agents.main, [f"--policy={missing}"], capsys)
