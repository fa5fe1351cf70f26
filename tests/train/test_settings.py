"""Every value that a setting allows is accepted, in Python and on the command line."""

import dataclasses
import json

import numpy as np
import pytest

from medjax.errors import InputError
from medjax.scenarios import prepare
from train.algorithms.environments import check_given
from train.algorithms.ppo.settings import PPOConfig
from train.option import example
from train.runs.arguments import parse_request
from train.settings import GIVEN, load_config, to_json

FIELDS = {field.name: field for field in dataclasses.fields(PPOConfig)}

BESIDE_SETTING = {
    "num_minibatches": {"num_envs": 2**20},
    "total_timesteps": {"num_envs": 2**20},
    "num_envs": {"num_minibatches": 1},
    "normalize_observations": {"policy_prior": "wait"},
    "credit": {"agents": "ippo"},
    "dispatcher": {"agents": "ippo"},
    "encoder": {"network": "sets", "observation": "flat"},
}
# Of fields that are names or mappings, whose range only the environment knows.
GOOD = {
    "scenario": ["paper", "corridor", "mine-own"],
    "overrides": [{}, {"cooldown_s": 30, "reward_weights.served": 0.5, "speeds": (14.0, 18.0)}],
    "reward": ["preset", "paper", "money", "mine:served,mine:late"],
    "wrapper": ["none", "mine:Wrapped"],
    "observation": ["profile", "flat"],
    "network": ["ramps", "mlp", "sets"],
}


def good_settings(field):
    if field.name in GOOD:
        return GOOD[field.name]
    one = field.default[0] if isinstance(field.default, tuple) else example(field)
    if isinstance(one, bool):
        return [True, False]
    if field.metadata["choices"]:
        return field.metadata["choices"]
    return [field.metadata["low"], field.metadata["high"], one]


@pytest.mark.parametrize("name", FIELDS)
def test_settings(name):
    """In Python and on the command line, up to the ends of the range."""
    field = FIELDS[name]
    beside = BESIDE_SETTING.get(name, {})
    flag = "--" + name.replace("_", "-")
    others = [f"--{other.replace('_', '-')}={value}" for other, value in beside.items()]
    values = good_settings(field)
    assert values
    for value in values:
        given = (value, value) if isinstance(field.default, tuple) else value
        config = PPOConfig(**{name: given}, **beside)
        assert getattr(config, name) == given
        if isinstance(value, bool):
            argv = [flag if value else flag.replace("--", "--no-", 1)]
        elif isinstance(given, dict):
            argv = [f"--set={key}={_text(number)}" for key, number in given.items()]
        elif isinstance(given, tuple):
            argv = [flag, *map(str, given)]
        else:
            argv = [f"{flag}={value}"]
        assert parse_request(PPOConfig, [*argv, *others]).config == config
        if isinstance(value, int | float) and not isinstance(value, bool) and given is value:
            same = np.asarray(value)[()]
            assert PPOConfig(**{name: same}, **beside) == config


def _text(number):
    return str([*number]) if isinstance(number, tuple) else str(number)


def test_the_number_of_environments_leaves_enough_updates():
    """Twice as many would leave fewer than 16 updates, but for the two ends, and whatever an episode's length."""
    for length in (360, 600, 3600):
        for decisions in (1, 300_000, *(2**power for power in range(10, 40))):
            config = PPOConfig(total_timesteps=decisions).for_episodes(length)
            assert config.num_envs in {32, 64, 128, 256, 512, 1024}
            assert config.num_envs == 32 or config.num_updates >= 16
            assert config.num_envs == 1024 or config.num_updates <= 32
            assert config.steps_per_update == config.num_envs * length


def test_steps_and_clip_follow_the_environments():
    """Both are constant up to 32 and from 1024 on, and grow by equal factors between."""

    def of(num_envs):
        config = PPOConfig(num_envs=num_envs).for_episodes(600)
        assert config.num_envs == num_envs
        return config.learning_rate, config.clip_epsilon

    for num_envs, expected in {
        1: (5e-4, 0.2),
        32: (5e-4, 0.2),
        1024: (1e-3, 1),
        8192: (1e-3, 1),
    }.items():
        assert of(num_envs) == pytest.approx(expected, rel=1e-12)
    values = np.log([of(32 * 2**power) for power in range(6)])
    np.testing.assert_allclose(np.diff(values, 2, axis=0), 0.0, atol=1e-12)


def test_a_longer_run_takes_smaller_steps():
    """The learning rate falls beyond ten million decisions, and never jumps."""

    def of(decisions):
        return PPOConfig(total_timesteps=decisions).for_episodes(600).learning_rate

    assert of(10_000_000) == 1e-3
    assert of(10_000_001) == pytest.approx(1e-3)
    assert of(60_000_000) == pytest.approx(3e-4, rel=0.02)
    rates = [of(10_000_000 * 2**power) for power in range(6)]
    assert np.all(np.diff(rates) < 0)


def test_what_is_given_stays_and_the_rest_follows_it(tmp_path):
    """However it is given: in Python, in a file, or on the command line over a file."""
    given = {"num_envs": 48, "learning_rate": 3e-4, "clip_epsilon": 0.3, "total_timesteps": 10**5}
    config = PPOConfig(**given, rollout_length=7, rule_sharpness=3.0)
    assert config.for_episodes(600) == config
    usual, agents = PPOConfig().for_episodes(600), PPOConfig(agents="ippo").for_episodes(150)
    assert (usual.num_envs, usual.total_timesteps, usual.num_updates) == (1024, 10_000_000, 17)
    assert (agents.num_envs, agents.total_timesteps) == (32, 500_000)
    path = tmp_path / "settings.yaml"
    path.write_text("seed: 3\n")
    argv = [f"--config={path}", "--agents=ippo"]
    over_file = parse_request(PPOConfig, argv).config.for_episodes(150)
    assert over_file == dataclasses.replace(agents, seed=3)
    assert dataclasses.replace(PPOConfig(), agents="ippo").for_episodes(150) == agents


@pytest.mark.parametrize(
    ("idle", "kept"),
    [
        ({"agents": "ippo", "observation": "flat"}, {"agents": "ippo"}),
        ({"policy_prior": "wait", "rule_sharpness": 2.0}, {"policy_prior": "wait"}),
        ({"start": "wait", "rule_sharpness": 2.0}, {"policy_prior": "wait"}),
        ({"encoder": [32]}, {}),
        ({"force": True}, {}),
        ({"rule_sharpness": None}, {}),
    ],
)
def test_what_did_nothing_in_a_run_is_left_out_of_its_settings(tmp_path, idle, kept):
    """Versions before accepted it, and their runs can still be opened. Where they name no sharpness, the rule had 4."""
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"config": idle, "versions": {}}))
    assert load_config(file, PPOConfig) == PPOConfig(**kept, rule_sharpness=4.0)


@pytest.mark.parametrize("other", [{"policy_prior": "wait"}, {"observation": "flat"}])
@pytest.mark.parametrize("decisions", [1_000_000, 10_000_000])
def test_another_run_may_take_over_the_default_sharpness(tmp_path, other, decisions):
    """Even one that does not start from the rule, to which the number that its file keeps says nothing."""
    first = PPOConfig(total_timesteps=decisions).for_episodes(600)
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"config": to_json(first), "versions": {}}))
    config = dataclasses.replace(load_config(file, PPOConfig), **other)
    assert config.rule_sharpness == first.rule_sharpness
    check_given(prepare("paper", observation=config.observation)[0], config)


def test_a_dispatcher_that_trains_on_many_episodes_starts_softer():
    """From 5000 episodes on, whatever their length; agents never do, and what is given stays."""
    for length in (360, 600):
        for decisions, expected in ((5000 * length - 1, 4.0), (5000 * length, 1.0)):
            config = PPOConfig(total_timesteps=decisions)
            assert config.for_episodes(length).rule_sharpness == expected
            given = dataclasses.replace(config, rule_sharpness=2.0, decide_every=7)
            assert given.for_episodes(length).rule_sharpness == 2.0
    assert PPOConfig().for_episodes(600).rule_sharpness == 1.0  # ten million decisions
    assert PPOConfig(rollout_length=10).for_episodes(600) == PPOConfig(
        rollout_length=10, rule_sharpness=1.0
    ).for_episodes(600)
    # Where nobody knows how long an episode is, rollouts do not count as episodes.
    assert PPOConfig(rollout_length=10).for_episodes(0).rule_sharpness == 4.0
    assert PPOConfig(agents="ippo", total_timesteps=10**9).for_episodes(150).rule_sharpness == 4.0


def test_a_soft_start_of_an_environment_of_one_s_own_is_kept(tmp_path):
    """Its profile decides that the rule is the start, and not the observation that the settings name."""
    given = {"observation": "flat", "rule_sharpness": 1.0}
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"config": given, "environment": GIVEN, "versions": {}}))
    assert load_config(file, PPOConfig, given=True) == PPOConfig(**given)


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
