"""Every value that a setting allows is accepted, in Python and on the command line."""

import dataclasses

import numpy as np
import pytest

from medjax.errors import InputError
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import parse_request
from train.settings import load_config

FIELDS = {field.name: field for field in dataclasses.fields(PPOConfig)}

BESIDE_SETTING = {
    "num_minibatches": {"num_envs": 2**20},
    "total_timesteps": {"num_envs": 2**20},
    "num_envs": {"num_minibatches": 1},
    "normalize_observations": {"policy_prior": "wait"},
    "credit": {"agents": "ippo"},
    "dispatcher": {"agents": "ippo"},
}


# Where 0 means a value that fits the other settings.
FILLED_IN = ("total_timesteps", "num_envs", "learning_rate", "clip_epsilon")


def good_settings(field):
    one = field.default[0] if isinstance(field.default, tuple) else field.default
    if isinstance(one, bool):
        return [True, False]
    if field.metadata["choices"]:
        return field.metadata["choices"]
    if not isinstance(one, int | float):
        return []
    if field.name in FILLED_IN:
        return [one + 1, field.metadata["high"]]
    return [field.metadata["low"], field.metadata["high"], one]


@pytest.mark.parametrize("name", FIELDS)
def test_settings(name):
    """In Python and on the command line, up to the ends of the range."""
    field = FIELDS[name]
    beside = BESIDE_SETTING.get(name, {})
    flag = "--" + name.replace("_", "-")
    others = [f"--{other.replace('_', '-')}={value}" for other, value in beside.items()]
    for value in good_settings(field):
        given = (value, value) if isinstance(field.default, tuple) else value
        config = PPOConfig(**{name: given}, **beside)
        assert getattr(config, name) == given
        if isinstance(value, bool):
            argv = [flag if value else flag.replace("--", "--no-", 1)]
        elif isinstance(given, tuple):
            argv = [flag, *map(str, given)]
        else:
            argv = [f"{flag}={value}"]
        assert parse_request(PPOConfig, [*argv, *others]).config == config
        if isinstance(value, int | float) and not isinstance(value, bool) and given is value:
            same = np.asarray(value)[()]
            assert PPOConfig(**{name: same}, **beside) == config


@pytest.mark.parametrize("name", FILLED_IN)
def test_zero_is_filled_in(name):
    usual = PPOConfig()
    assert PPOConfig(**{name: 0}) == usual
    assert getattr(usual, name) > 0
    assert parse_request(PPOConfig, [f"--{name.replace('_', '-')}=0"]).config == usual


def test_environments_leave_enough_updates():
    """Twice as many would leave fewer than 16, and half as many more than 32, but for the two ends."""
    for decisions in [1, 300_000, *(2**power for power in range(10, 40))]:
        config = PPOConfig(total_timesteps=decisions)
        assert config.num_envs in {32, 64, 128, 256, 512, 1024}
        assert config.num_envs == 32 or config.num_updates >= 16
        assert config.num_envs == 1024 or config.num_updates <= 32
    agents = PPOConfig(agents="ippo")
    assert (agents.num_envs, agents.total_timesteps) == (32, 500_000)


def test_steps_and_clip_follow_the_environments():
    """Both are constant up to 32 and from 1024 on, and grow by equal factors between."""
    ends = {1: (5e-4, 0.2), 32: (5e-4, 0.2), 1024: (1e-3, 1.0), 8192: (1e-3, 1.0)}
    for num_envs, expected in ends.items():
        for config in (
            PPOConfig(num_envs=num_envs),
            parse_request(PPOConfig, [f"--num-envs={num_envs}"]).config,
        ):
            assert (config.learning_rate, config.clip_epsilon) == pytest.approx(expected, rel=1e-12)
    between = [PPOConfig(num_envs=32 * 2**power) for power in range(6)]
    for name in ("learning_rate", "clip_epsilon"):
        values = np.array([getattr(config, name) for config in between])
        np.testing.assert_allclose(np.diff(np.log(values), 2), 0.0, atol=1e-12)


def test_a_defect_of_ours_is_not_called_a_bad_file(tmp_path, monkeypatch):
    """A ValueError that the file's text did not cause is not the user's mistake."""
    path = tmp_path / "config.json"
    path.write_text("{}")

    def fails(*_):
        raise ValueError("defect")

    monkeypatch.setattr("train.settings.from_json", fails)
    with pytest.raises(ValueError, match=r"^defect$") as caught:
        load_config(path, PPOConfig)
    assert not isinstance(caught.value, InputError)


NAMES = [
    *("runs/a", "../x", "/tmp/x y", "-rf", "con", "é€", "🚚", "a" * 255, "./~", "x.", "..."),
    *("a/../b", "run/"),
]


@pytest.mark.parametrize("name", NAMES)
def test_paths_of_any_usual_name(name):
    expected = name.rstrip("/").removeprefix("./")
    assert str(parse_request(PPOConfig, [f"--run-dir={name}"]).run_dir) == expected
