"""What the Gymnasium environments draw, and libraries that are missing for it."""

import sys
import warnings

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason='pip install -e ".[gymnasium]"')

from gymnasium.error import DependencyNotInstalled  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

from medjax.env.charging_env import ChargingEnv  # noqa: E402
from medjax.errors import MissingLibrary  # noqa: E402
from medjax.wrappers.gymnasium import ENV_ID, ChargingGymEnv  # noqa: E402
from tests.wrappers.test_gymnasium import NUM, SMALL  # noqa: E402

pytestmark = pytest.mark.usefixtures("quick_compiles")


@pytest.fixture
def painted(monkeypatch):
    """A picture of one colour, the number of the decision; how the road is drawn is tested elsewhere."""

    def render(self, state, params):
        return np.full((48, 64, 3), int(state.time), np.uint8)

    monkeypatch.setattr(ChargingEnv, "render", render)


@pytest.fixture
def window(monkeypatch):
    """pygame, whose windows nobody sees, and an environment shown in Gymnasium's own."""
    pygame = pytest.importorskip("pygame", reason='pip install "gymnasium[classic-control]"')
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.warns(UserWarning, match="HumanRendering"):
        env = gymnasium.make(ENV_ID, **SMALL, render_mode="human")
    yield pygame, env
    env.close()


@pytest.mark.thorough
def test_check_env_draws_in_every_render_mode(painted):
    env = gymnasium.make(ENV_ID, **SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert check_env(env.unwrapped) is None


def test_a_picture_shows_the_current_decision(painted):
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


def test_human_mode_shows_every_step_in_a_window(painted, window):
    pygame, env = window
    assert type(env.unwrapped) is ChargingGymEnv
    env.reset(seed=1)
    assert pygame.display.get_surface().get_size() == (64, 48)
    env.step(0)
    assert pygame.display.get_surface().get_at((5, 5))[:3] == (1, 1, 1)
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None


def test_missing_libraries_are_named_with_their_remedy(painted, window, monkeypatch):
    _, env = window
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
