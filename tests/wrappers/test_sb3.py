"""Stable-Baselines3 on Gymnasium environments: PPO learns, and masked PPO obeys the masks.

In this world EVs arrive well charged and sending a MED costs reward, so PPO must learn to send none, while an untrained
policy sends most of the fleet. The other terms of the reward add noise.
"""

import numpy as np
import pytest

NEEDED = 'pip install -e ".[gymnasium,sb3]"'
pytest.importorskip("gymnasium", reason=NEEDED)
torch = pytest.importorskip("torch", reason=NEEDED)
sb3 = pytest.importorskip("stable_baselines3", reason=NEEDED)

import gymnasium  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402

from medjax.errors import InputError  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID  # noqa: E402

DECISIONS = 20
DEAR_TRUCKS = {
    "num_meds": 15,
    "num_evs": 8,
    "num_gas": 12,
    "mainline_per_h": 600.0,
    "cooldown_s": 0.0,
    "episode_decisions": DECISIONS,
    "arrival_soc_low": 0.8,
    "arrival_soc_high": 0.9,
    "reward_weights": {"dispatches": -1.0},
}
STEPS = 4096
EPISODES = 30  # first and last ones, which are compared


@pytest.fixture(autouse=True)
def one_thread():
    """Networks this small are slower on two."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def env():
    return Monitor(gymnasium.make(ENV_ID, **DEAR_TRUCKS))


def test_checker_of_sb3_finds_nothing(env, recwarn):
    check_env(env.unwrapped, warn=True, skip_render_check=True)
    assert [str(warning.message) for warning in recwarn if warning.category is UserWarning] == []


@pytest.mark.thorough
def test_ppo_earns_more_the_longer_it_trains(env):
    model = sb3.PPO(
        "MlpPolicy", env, n_steps=512, batch_size=64, gamma=0.9, device="cpu", seed=0, verbose=0
    )
    model.learn(STEPS)
    returns = np.asarray(env.get_episode_rewards())
    assert len(returns) == STEPS // DECISIONS
    first, last = returns[:EPISODES], returns[-EPISODES:]
    error = np.sqrt((first.var(ddof=1) + last.var(ddof=1)) / EPISODES)
    rise = last.mean() - first.mean()
    print(f"return {first.mean():.2f} -> {last.mean():.2f}, standard error {error:.2f}")
    assert rise > 4.0 * error  # by chance once in thirty thousand runs
    assert rise > 5.0  # MEDs that stay at the depot


def test_masked_ppo_never_takes_a_forbidden_action():
    contrib = pytest.importorskip("sb3_contrib", reason=NEEDED)
    from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported

    world = {**DEAR_TRUCKS, "cooldown_s": 5.0}
    env = Monitor(gymnasium.make(ENV_ID, **world), info_keywords=("metrics",))
    assert is_masking_supported(env)
    model = contrib.MaskablePPO("MlpPolicy", env, n_steps=128, device="cpu", seed=0)
    model.learn(128)
    obs, info = env.reset(seed=1)
    forbidden = 0
    for _ in range(DECISIONS):
        masks = get_action_masks(env)
        np.testing.assert_array_equal(masks, info["action_mask"])
        forbidden += (~masks).sum()
        action, _ = model.predict(obs, action_masks=masks)
        obs, _, _, _, info = env.step(action)
    assert forbidden > 0
    assert info["metrics"]["invalid_actions"] == 0.0
    assert info["metrics"]["meds_dispatched"] >= 1.0


@pytest.fixture
def many():
    pytest.importorskip("sb3_contrib", reason=NEEDED)
    from medjax.wrappers.sb3 import ChargingVecEnv

    env = ChargingVecEnv(8, render_mode="rgb_array", **DEAR_TRUCKS)
    yield env
    env.close()


def test_many_highways_play_as_single_ones(many):
    """Copy i of seed s is the single environment of seed s + i; each copy has a picture."""
    many.seed(3)
    rows = many.reset()
    singles = [gymnasium.make(ENV_ID, **DEAR_TRUCKS) for _ in range(many.num_envs)]
    for number, single in enumerate(singles):
        np.testing.assert_allclose(rows[number], single.reset(seed=3 + number)[0], atol=1e-5)
    actions = np.random.default_rng(0).integers(0, many.action_space.n, (DECISIONS, many.num_envs))
    for decision in range(DECISIONS):
        rows, rewards, ended, infos = many.step(actions[decision])
        assert set(ended) == {decision == DECISIONS - 1}
        for number, single in enumerate(singles):
            seen, reward, *_ = single.step(actions[decision, number])
            shown = infos[number].get("terminal_observation", rows[number])
            np.testing.assert_allclose(shown, seen, atol=1e-4)
            np.testing.assert_allclose(rewards[number], reward, atol=1e-4)
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert infos[0]["metrics"]["meds_dispatched"] > 0.0
    first, *others = many.get_images()
    assert first.shape[-1] == 3
    assert [picture.shape for picture in others] == [first.shape] * (many.num_envs - 1)


def test_an_attribute_is_set_for_all_copies_or_none(many):
    with pytest.raises(InputError, match="label: copies share it, allowed: set for all of them"):
        many.set_attr("label", 3, indices=[0, 2])
    many.set_attr("label", 3)
    assert many.get_attr("label") == [3] * many.num_envs


def test_masked_ppo_learns_in_many_highways(many):
    """With the copies' own masks; SB3's monitor counts episodes and returns."""
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
    from stable_baselines3.common.vec_env import VecMonitor

    env = VecMonitor(many)
    assert is_masking_supported(env)
    model = MaskablePPO(
        "MlpPolicy", env, n_steps=64, batch_size=64, gamma=0.9, device="cpu", seed=0
    )
    model.learn(2048)
    first = model.ep_info_buffer
    assert {episode["l"] for episode in first} == {DECISIONS}
    returns = np.array([episode["r"] for episode in first])
    assert len(returns) > 2 * EPISODES
    rise = returns[-EPISODES:].mean() - returns[:EPISODES].mean()
    assert rise > 4.0 * returns.std() * np.sqrt(2.0 / EPISODES)
    np.testing.assert_array_equal(get_action_masks(env), many.action_masks())
