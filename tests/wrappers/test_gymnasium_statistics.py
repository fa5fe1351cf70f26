"""What Gymnasium's own wrapper counts of a vector environment, and the warning where that is wrong."""

import warnings

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402

from medjax.wrappers.gymnasium import ENV_ID  # noqa: E402
from medjax.wrappers.gymnasium.vector import COUNTS_WRONG  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS, NUM = 6, 3
SMALL = {"num_meds": 3, "num_evs": 8, "num_gas": 12, "episode_decisions": DECISIONS}


@pytest.fixture
def envs():
    return gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL)


def test_vector_wrappers_of_gymnasium_count_its_episodes(envs):
    envs = RecordEpisodeStatistics(envs)
    envs.reset(seed=3)
    total = np.zeros(NUM)
    for _ in range(DECISIONS):
        _, reward, _, _, infos = envs.step(np.zeros(NUM, int))
        total += reward
    assert infos["episode"]["l"].tolist() == [DECISIONS] * NUM
    np.testing.assert_allclose(infos["episode"]["r"], total)
    for _ in range(DECISIONS):
        *_, infos = envs.step(np.zeros(NUM, int))
    # The second one, by Gymnasium 1.4; those before lose its first decision, which a warning says.
    assert infos["episode"]["l"].tolist() == [DECISIONS - COUNTS_WRONG] * NUM


def test_older_versions_of_gymnasium_are_warned_of():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL)
    assert any("RecordEpisodeStatistics" in str(each.message) for each in said) is COUNTS_WRONG
