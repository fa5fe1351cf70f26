"""The Gymnasium environments' keywords and actions, and their copies by pickle."""

import pickle

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from medjax.errors import InputError  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID, ChargingGymEnv  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_compiles")

NUM = 3
SMALL = {"num_meds": 3, "num_evs": 8, "num_gas": 12, "mainline_per_h": 600.0}


@pytest.fixture
def env():
    return gymnasium.make(ENV_ID, **SMALL)


@pytest.fixture
def envs():
    return gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL)


@pytest.mark.parametrize(
    "actions",
    [
        [1.9, 0, 0],
        np.zeros((NUM, 1), int),
        np.zeros(NUM + 1, int),
        0,
        "abc",
        [0, None, 0],
        [[0], 1],
    ],
    ids=str,
)
def test_vector_actions_are_integers_one_a_copy(envs, actions):
    envs.reset(seed=1)
    with pytest.raises(
        InputError, match=r"allowed 3 integers .* \(3,\), each from 0 to 4"
    ) as refusal:
        envs.step(actions)
    assert "\n" not in str(refusal.value)


def test_an_action_is_one_integer(env):
    """A whole number of any type is the same action; one beyond the space counts as invalid, however large."""
    env.reset(seed=1)
    for action in (0.5, np.zeros(1, int), None, float("nan")):
        with pytest.raises(InputError, match="allowed an integer, each from 0 to 4"):
            env.unwrapped.step(action)
    for count, action in enumerate((2**32, -(2**40)), start=1):
        assert env.unwrapped.step(action)[-1]["metrics"]["invalid_actions"] == count
    assert env.unwrapped.step(np.float32(0.0))[-1]["metrics"]["invalid_actions"] == 2


def test_both_pickle_and_go_on_alike(env, envs):
    """In the middle of an episode."""
    for each, action in ((env.unwrapped, 0), (envs, [0] * NUM)):
        each.reset(seed=1)
        copy = pickle.loads(pickle.dumps(each))
        for mine, theirs in zip(each.step(action)[:4], copy.step(action)[:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"decide_evry": 3}, "unknown option 'decide_evry': did you mean decide_every"),
        ({"scenari": "paper"}, "unknown option 'scenari': did you mean scenario"),
        ({"env": 3, "parms": 3}, "unknown option 'parms': did you mean params"),
        ({"obsrvation": "flat"}, "unknown option 'obsrvation': did you mean observation"),
        ({"max_episode_step": 3}, "unknown option 'max_episode_step': did you mean max_episode_st"),
        ({"vectorisation_mode": 3}, "unknown option 'vectorisation_mode': did you mean vectoriz"),
    ],
)
def test_a_misspelt_keyword_is_told(change, message):
    with pytest.raises(InputError, match=message):
        ChargingGymEnv(**change)
    with pytest.raises(InputError, match=message):
        gymnasium.make(ENV_ID, **change)
