"""Stable-Baselines3 on the Gymnasium environment: it learns, and its masked PPO obeys the masks.

In this world EVs arrive well charged and trucks cost something to send: PPO must learn to send none. A policy that has
learnt nothing sends most of the fleet. The other terms of the reward stay as they are, as noise.
"""

import numpy as np
import pytest

NEEDED = 'pip install "medjax[gymnasium]" stable-baselines3 sb3-contrib'
pytest.importorskip("gymnasium", reason=NEEDED)
torch = pytest.importorskip("torch", reason=NEEDED)
sb3 = pytest.importorskip("stable_baselines3", reason=NEEDED)

import gymnasium  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402

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
EPISODES = 30  # that are compared: the first ones with the last ones


@pytest.fixture(autouse=True)
def one_thread():
    """Networks so small are slower on two."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def env():
    return Monitor(gymnasium.make(ENV_ID, **DEAR_TRUCKS))


def test_checker_of_sb3_has_nothing_to_say(env, recwarn):
    check_env(env.unwrapped, warn=True, skip_render_check=True)
    assert [str(warning.message) for warning in recwarn if warning.category is UserWarning] == []


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
    assert rise > 5.0  # trucks that stay at the depot


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
