"""PettingZoo's own test of the parallel API."""

import pickle
import warnings

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import medjax
from medjax.errors import InputError

pytest.importorskip("pettingzoo", reason='pip install "pettingzoo>=1.25"')

from pettingzoo.test import parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec

from medjax.wrappers.pettingzoo import ParallelAgents

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"size": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0}


@pytest.fixture(scope="module")
def named():
    return medjax.make_agents("paper", **SMALL, episode_decisions=3, rounds_per_decision=2)


def test_parallel_api(named):
    with warnings.catch_warnings(record=True) as said:  # the test only warns of many faults
        warnings.simplefilter("always")
        parallel_api_test(ParallelAgents(named), num_cycles=10)
    assert [str(warning.message) for warning in said] == []


def test_seeds_repeat_episodes(named):
    parallel_seed_test(lambda: ParallelAgents(named), num_cycles=4)
    first, again, other = (
        np.stack(list(ParallelAgents(named).reset(seed=seed)[0].values())) for seed in (3, 3, 4)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_episodes_without_a_seed_differ(named):
    """In one environment and between two, as of two workers."""
    one, other = (ParallelAgents(named) for _ in range(2))
    # Of several episodes: one pair in sixty begins alike for MEDs, which see little from their depot.
    drawn = [
        np.stack([list(each.reset()[0].values()) for _ in range(6)]) for each in (one, one, other)
    ]
    assert not any(np.array_equal(drawn[0], later) for later in drawn[1:])


def test_an_episode_is_truncated_for_all(named):
    """The caller may keep and change results; a bad action changes nothing."""
    env = ParallelAgents(named)
    with pytest.raises(ResetNeeded):
        env.step({})
    _, infos = env.reset(seed=1)
    with pytest.raises(InputError, match="med_1 = 99"):
        env.step(dict.fromkeys(env.agents, 0) | {"med_1": 99})
    assert infos["med_0"]["action_mask"].shape == (named.env.num_actions,)
    for number in range(3):
        obs, _, ended, cut, infos = env.step(dict.fromkeys(env.agents, 0))
        assert not any(ended.values())
        assert set(cut.values()) == {number == 2}
        obs["med_0"] *= 0.0
        infos["med_0"]["metrics"]["mine"] = 1.0
        assert "mine" not in infos["med_1"]["metrics"]
    assert env.agents == []
    assert infos["med_1"]["metrics"]["collisions"] == 0.0
    for late in ({}, dict.fromkeys(env.possible_agents, 0)):
        with pytest.raises(ResetNeeded):
            env.step(late)
    env.reset()
    env.step(dict.fromkeys(env.agents, 0))


def test_converts_to_the_agent_environment_cycle_api(named, caplog):
    assert parallel_to_aec(ParallelAgents(named)).render_mode is None
    assert not caplog.records


def test_pickles_in_the_middle_of_an_episode(named):
    env = ParallelAgents(named)
    env.reset(seed=1)
    copy = pickle.loads(pickle.dumps(env))
    waiting = dict.fromkeys(env.agents, 0)
    for mine, theirs in zip(env.step(waiting)[:2], copy.step(waiting)[:2], strict=True):
        for agent in waiting:
            np.testing.assert_array_equal(mine[agent], theirs[agent])
