"""The Gymnasium environments under Gymnasium's own checker, vector environments and wrappers."""

import pickle
import warnings

import jax
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from gymnasium.error import ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env, data_equivalence  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402

import medjax  # noqa: E402
from medjax.errors import InputError  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID  # noqa: E402
from medjax.wrappers.gymnasium.vector import COUNTS_WRONG  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_compiles")

DECISIONS, NUM = 6, 3
SMALL = {
    "num_meds": 3,
    "num_evs": 8,
    "num_gas": 12,
    "mainline_per_h": 600.0,
    "episode_decisions": DECISIONS,
}


@pytest.fixture
def env():
    env = gymnasium.make(ENV_ID, **SMALL)
    yield env
    env.close()


@pytest.fixture
def envs():
    envs = gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL)
    yield envs
    envs.close()


@pytest.mark.thorough
def test_an_episode_is_truncated_and_repeats_with_its_seed(env):
    def episode():
        steps = [env.reset(seed=5)]
        while len(steps) == 1 or not steps[-1][3]:
            steps.append(env.step(0))
        return steps

    first = episode()
    second, _ = env.reset()
    for one, other in zip(first, episode(), strict=True):
        assert data_equivalence(one, other, exact=True)
    assert not np.array_equal(first[0][0], second)
    np.testing.assert_array_equal(env.reset()[0], second)
    assert not np.array_equal(env.reset(seed=6)[0], first[0][0])
    assert len(first) == 1 + DECISIONS
    assert not any(terminated for _, _, terminated, _, _ in first[1:])
    obs, reward, terminated, truncated, info = first[-1]
    assert truncated is True
    assert (type(reward), type(terminated)) == (float, bool)
    assert obs.dtype == np.float32
    assert obs.flags.writeable
    assert set(info) == {"action_mask", "metrics", "reward_terms"}
    assert sum(info["reward_terms"].values()) == pytest.approx(reward, rel=1e-5)
    assert all(type(value) is float for value in info["metrics"].values())
    assert info["metrics"]["vehicle_ticks"] > 0


@pytest.mark.thorough
def test_plays_what_the_environment_itself_plays(env):
    """The checker has nothing to say, the numbers are the simulator's, and the mask shows the cooldown."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    reference, params = medjax.make("paper", **SMALL)
    assert env.unwrapped.simulator.config == reference.config
    obs, info = env.reset(seed=3)
    assert info["action_mask"].all()
    before = jax.tree.map(np.array, env.unwrapped._state)
    seen = reference.observation(before, reference.config, params)
    np.testing.assert_allclose(obs, seen, rtol=1e-5, atol=1e-6)
    _, reward, _, _, info = env.step(np.int64(1))
    assert int(env.unwrapped._state.time) == int(before.time) + 1
    assert info["metrics"]["meds_dispatched"] == 1.0
    assert reward == pytest.approx(sum(info["reward_terms"].values()), rel=1e-5)
    expected = [True] + [False] * (env.action_space.n - 1)
    assert info["action_mask"].tolist() == expected
    assert env.get_wrapper_attr("action_masks")().tolist() == expected


def test_environments_built_alike_share_their_programs(env):
    """Each keeps its own numbers."""
    other = gymnasium.make(ENV_ID, **SMALL, cooldown_s=30.0)
    assert other.unwrapped._program is env.unwrapped._program
    assert float(other.unwrapped.params.fleet.cooldown_s) == 30.0
    assert other.unwrapped.simulator.recipe.overrides["cooldown_s"] == 30.0


@pytest.mark.thorough
def test_decide_every_takes_one_action_and_then_none():
    """Each step sends one MED, and rewards add up."""
    terms = {"dispatches": -1.0, "depleted": 0.0, "soc": 0.0, "distance": 0.0, "speed": 0.0}
    charged = {"arrival_soc_low": 0.8, "arrival_soc_high": 0.9}
    world = {**SMALL, **charged, "num_meds": 15, "cooldown_s": 0.0, "episode_decisions": 20}
    env = gymnasium.make(ENV_ID, **world, reward_weights=terms, decide_every=5)
    env.reset(seed=0)
    steps, over = 0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(1)
        assert reward == -1.0
        over = terminated or truncated
        steps += 1
    assert steps == 20 // 5
    assert info["metrics"]["meds_dispatched"] == steps


@pytest.mark.parametrize("observation", ["flat", "profile"])
def test_observations_lie_in_their_space(observation):
    env = gymnasium.make(ENV_ID, **SMALL, observation=observation)
    _, params = medjax.make("paper", **SMALL)
    size = env.unwrapped.simulator.observation_space(params).shape
    assert env.observation_space.shape == size
    assert env.observation_space.contains(env.observation_space.sample())


@pytest.mark.thorough
def test_vector_env_plays_as_single_ones_in_gymnasiums_vector_env(envs):
    """Gymnasium's own wrapper counts its episodes."""
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    singles = SyncVectorEnv(
        [lambda: gymnasium.make(ENV_ID, **SMALL)] * NUM, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert envs.single_observation_space == singles.single_observation_space
    assert envs.action_space == singles.action_space
    assert_alike(envs.reset(seed=7), singles.reset(seed=7))
    rng = np.random.default_rng(0)
    for number in range(DECISIONS):
        actions = rng.integers(0, envs.single_action_space.n, NUM)
        mine, theirs = envs.step(actions), singles.step(actions)
        if number < DECISIONS - 1:
            assert_alike(mine, theirs)
    # All episodes end together, by truncation; what follows is drawn anew in either.
    assert_alike(mine[1:4], theirs[1:4])
    assert mine[3].all()
    assert_alike(mine[4]["final_info"], theirs[4]["final_info"])
    for name in ("_final_info", "_final_obs", "_action_mask"):
        np.testing.assert_array_equal(mine[4][name], theirs[4][name])
    assert mine[4]["final_obs"].dtype == object
    for own, other in zip(mine[4]["final_obs"], theirs[4]["final_obs"], strict=True):
        np.testing.assert_allclose(own, other, atol=1e-4)
    pairs = zip(mine[0], mine[4]["final_obs"], strict=True)
    assert not any(np.array_equal(*pair) for pair in pairs)
    assert len(np.unique(mine[0], axis=0)) == NUM
    np.testing.assert_array_equal(envs.action_masks(), mine[4]["action_mask"])
    mine[4]["action_mask"][:] = False  # the caller's own
    assert envs.action_masks().any(axis=1).all()


def assert_alike(mine, theirs):
    """The same values, shapes and names; Gymnasium keeps floats of infos in float64."""
    if isinstance(theirs, dict):
        assert set(mine) == set(theirs)
        for name in theirs:
            assert_alike(mine[name], theirs[name])
    elif isinstance(theirs, tuple):
        for one, other in zip(mine, theirs, strict=True):
            assert_alike(one, other)
    else:
        assert mine.shape == theirs.shape
        assert mine.dtype.kind == theirs.dtype.kind
        np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-4)


def test_vector_env_seeding(envs):
    first, _ = envs.reset(seed=1)
    second, _ = envs.reset()
    shifted, _ = envs.reset(seed=[2, 3, 1])
    np.testing.assert_array_equal(first[[1, 2, 0]], shifted)
    assert not (first == second).all(axis=1).any()
    envs.reset(seed=1)
    np.testing.assert_array_equal(envs.reset()[0], second)
    with pytest.raises(ValueError, match="2 seeds: allowed 3"):
        envs.reset(seed=[1, 2])


@pytest.mark.thorough
def test_gymnasium_counts_the_episodes_of_a_vector_env():
    """Versions before 1.4 lose the first decision of each later episode, which a warning says."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        envs = RecordEpisodeStatistics(gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL))
    assert any("RecordEpisodeStatistics" in str(each.message) for each in said) is COUNTS_WRONG
    envs.reset(seed=3)
    rewards = np.zeros(NUM)
    for length in (DECISIONS, DECISIONS - COUNTS_WRONG):
        for _ in range(DECISIONS):
            _, reward, _, _, infos = envs.step(np.zeros(NUM, int))
            rewards += reward
        assert infos["episode"]["l"].tolist() == [length] * NUM
        if length == DECISIONS:
            np.testing.assert_allclose(infos["episode"]["r"], rewards)
        rewards[:] = 0.0


def test_nothing_works_before_the_first_reset(env, envs):
    for act in (lambda: env.unwrapped.step(0), env.unwrapped.action_masks, lambda: envs.step([0])):
        with pytest.raises(ResetNeeded):
            act()


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
    said = r"allowed 3 integers .* \(3,\), each from 0 to 4"
    with pytest.raises(InputError, match=said) as refusal:
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


@pytest.mark.thorough
def test_copies_by_pickle_go_on_alike(env, envs):
    """In the middle of an episode."""
    for each, action in ((env.unwrapped, 0), (envs, [0] * NUM)):
        each.reset(seed=1)
        copy = pickle.loads(pickle.dumps(each))
        for mine, theirs in zip(each.step(action)[:4], copy.step(action)[:4], strict=True):
            np.testing.assert_array_equal(mine, theirs)
