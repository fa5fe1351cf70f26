"""The Gymnasium environments under Gymnasium's own checker, vector environments and wrappers."""

import sys
import warnings

import jax
import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from gymnasium.error import DependencyNotInstalled, ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env, data_equivalence  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402

import medjax  # noqa: E402
from medjax.env.charging_env import ChargingEnv  # noqa: E402
from medjax.errors import InputError, MissingLibrary  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID, ChargingGymEnv, ChargingVectorEnv  # noqa: E402

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


@pytest.fixture
def painted(monkeypatch):
    """A picture that says which decision it shows; how the road is drawn is tested elsewhere."""

    def render(self, state, params):
        return np.full((48, 64, 3), int(state.time), np.uint8)

    monkeypatch.setattr(ChargingEnv, "render", render)


def episode(env, seed, action=0):
    """Observations, rewards and flags of a whole episode."""
    obs, info = env.reset(seed=seed)
    steps = [(obs, 0.0, False, False, info)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(action))
    return steps


def test_check_env_has_nothing_to_say(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


def test_check_env_draws_in_every_render_mode(env, painted, monkeypatch):
    pytest.importorskip("pygame", reason='pip install "gymnasium[classic-control]"')
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(env.unwrapped)


def test_an_episode_is_truncated_by_its_time_limit(env):
    steps = episode(env, seed=1)
    assert len(steps) == 1 + DECISIONS
    assert not any(terminated for _, _, terminated, _, _ in steps)
    obs, reward, terminated, truncated, info = steps[-1]
    assert truncated is True
    assert (type(reward), type(terminated)) == (float, bool)
    assert obs.dtype == np.float32
    assert obs.flags.writeable
    assert set(info) == {"action_mask", "metrics", "reward_terms"}
    assert sum(info["reward_terms"].values()) == pytest.approx(reward, rel=1e-5)
    assert all(type(value) is float for value in info["metrics"].values())
    assert info["metrics"]["vehicle_ticks"] > 0


def test_one_seed_one_course_and_the_next_episode_is_another(env):
    first = episode(env, seed=5)
    second, _ = env.reset()
    again = episode(env, seed=5)
    for one, other in zip(first, again, strict=True):
        assert data_equivalence(one, other, exact=True)
    assert not np.array_equal(first[0][0], second)
    np.testing.assert_array_equal(env.reset()[0], second)
    assert not np.array_equal(env.reset(seed=6)[0], first[0][0])


def test_plays_what_the_environment_itself_plays(env):
    charging = env.unwrapped.simulator
    reference, params = medjax.make("paper", **SMALL)
    assert charging.config == reference.config
    obs, _ = env.reset(seed=3)
    before = jax.tree.map(np.array, env.unwrapped._state)
    seen = reference.observation(before, reference.config, params)
    np.testing.assert_allclose(obs, seen, rtol=1e-5, atol=1e-6)
    _, reward, _, _, info = env.step(1)
    after = env.unwrapped._state
    assert int(after.time) == int(before.time) + 1
    assert info["metrics"]["meds_dispatched"] == 1.0
    assert reward == pytest.approx(sum(info["reward_terms"].values()), rel=1e-5)


def test_masks_forbid_what_the_cooldown_forbids(env):
    _, info = env.reset(seed=2)
    assert info["action_mask"].all()
    *_, info = env.step(np.int64(2))
    expected = [True] + [False] * (env.action_space.n - 1)
    assert info["action_mask"].tolist() == expected
    assert env.get_wrapper_attr("action_masks")().tolist() == expected


def test_environments_built_alike_share_their_programs(env):
    other = gymnasium.make(ENV_ID, **SMALL, cooldown_s=30.0)
    assert other.unwrapped._program is env.unwrapped._program
    assert float(other.unwrapped.params.fleet.cooldown_s) == 30.0
    assert other.unwrapped.simulator.recipe.overrides["cooldown_s"] == 30.0


@pytest.mark.parametrize("observation", ["flat", "profile"])
def test_observations_lie_in_their_space(observation):
    env = gymnasium.make(ENV_ID, **SMALL, observation=observation)
    _, params = medjax.make("paper", **SMALL)
    size = env.unwrapped.simulator.observation_space(params).shape
    assert env.observation_space.shape == size
    assert env.observation_space.contains(env.observation_space.sample())


def test_vector_env_plays_as_single_ones_in_gymnasiums_vector_env(envs):
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    singles = SyncVectorEnv(
        [lambda: gymnasium.make(ENV_ID, **SMALL)] * NUM, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert envs.single_observation_space == singles.single_observation_space
    assert envs.action_space == singles.action_space
    mine, theirs = envs.reset(seed=7), singles.reset(seed=7)
    assert_alike(mine, theirs)
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
    assert not any(
        np.array_equal(*pair) for pair in zip(mine[0], mine[4]["final_obs"], strict=True)
    )
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


def test_pictures(painted):
    env = gymnasium.make(ENV_ID, **SMALL, render_mode="rgb_array")
    env.reset(seed=1)
    env.step(0)
    frame = env.render()
    assert frame.shape == (48, 64, 3)
    assert (frame == 1).all()
    envs = gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL, render_mode="rgb_array")
    envs.reset(seed=1)
    assert [frame.shape for frame in envs.render()] == [(48, 64, 3)] * NUM


def test_the_road_is_drawn():
    pytest.importorskip("PIL", reason='pip install -e ".[render]"')
    env = gymnasium.make(ENV_ID, **SMALL, render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    for _ in range(3):
        env.step(1)
    assert (first.dtype, first.ndim, first.shape[2]) == (np.uint8, 3, 3)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 10
    assert (env.render() != first).any()
    envs = gymnasium.make_vec(ENV_ID, num_envs=NUM, **SMALL, render_mode="rgb_array")
    envs.reset(seed=1)
    np.testing.assert_array_equal(envs.render()[0], first)


def test_human_mode_shows_every_step_in_a_window(painted, monkeypatch):
    pygame = pytest.importorskip("pygame", reason='pip install "gymnasium[classic-control]"')
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make(ENV_ID, **SMALL, render_mode="human")
    assert type(env.unwrapped) is ChargingGymEnv
    env.reset(seed=1)
    assert pygame.display.get_surface().get_size() == (64, 48)
    env.step(0)
    assert pygame.display.get_surface().get_at((5, 5))[:3] == (1, 1, 1)
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None


def test_missing_libraries_are_named_with_their_remedy(painted, monkeypatch):
    env = gymnasium.make(ENV_ID, **SMALL, render_mode="human")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "gymnasium\[classic-control\]"'):
        env.reset()

    def missing(self, state, params):
        raise MissingLibrary("Pillow")

    monkeypatch.setattr(ChargingEnv, "render", missing)
    env = gymnasium.make(ENV_ID, **SMALL, render_mode="rgb_array")
    env.reset()
    with pytest.raises(DependencyNotInstalled, match=r'pip install -e "\.\[render\]"'):
        env.render()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "papr"}, "unknown scenario 'papr': did you mean paper"),
        ({"cooldwn_s": 3}, "unknown option 'cooldwn_s': did you mean cooldown_s"),
        ({"render_mode": "ansi"}, "render_mode = 'ansi': allowed None, human, rgb_array"),
        ({"decide_every": 1.0}, "decide_every is 1.0, must be a whole number"),
    ],
)
def test_bad_input_is_refused_in_one_line(change, message):
    with pytest.raises(ValueError, match=message) as refusal:
        ChargingGymEnv(**{**SMALL, **change})
    assert "\n" not in str(refusal.value)


def test_nothing_works_before_the_first_reset(env, envs):
    for act in (lambda: env.unwrapped.step(0), env.unwrapped.action_masks, lambda: envs.step([0])):
        with pytest.raises(ResetNeeded):
            act()
    with pytest.raises(ValueError, match="num_envs is 0, must be a whole number, at least 1"):
        gymnasium.make_vec(ENV_ID, num_envs=0, **SMALL)
    for number in (None, "3", 1.5, float("nan")):
        with pytest.raises(InputError, match="num_envs is"):
            ChargingVectorEnv(number, **SMALL)
    with pytest.raises(InputError, match="env is 3: allowed an environment"):
        ChargingVectorEnv(1, env=3, params=3)
