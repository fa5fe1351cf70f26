"""Bad input: one clear line on stderr, exit code 2, and nothing is made or overwritten."""

import dataclasses
import json
import subprocess
import sys

import pytest

from medjax.commandline import parse_overrides
from medjax.errors import InputError
from tests.train.conftest import TINY, exit_code, refused
from train import evaluate, ppo
from train.algorithms.ppo.settings import PPOConfig
from train.runs.arguments import parse_request
from train.settings import from_json, to_json


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--scenario=nowhere"], ["nowhere", "allowed", "noisy"]),
        (["--frobnicate=3"], ["--frobnicate"]),
        (["--num-env=3"], ["--num-env"]),
        (["positional"], ["positional"]),
        (["--num-envs=-4"], ["num_envs is -4", "at least 1"]),
        (["--num-envs=0"], ["num_envs is 0", "at least 1"]),
        (["--num-envs=many"], ["num_envs is 'many'", "a whole number"]),
        (["--num-envs=1.5"], ["num_envs is '1.5'", "a whole number"]),
        (["--num-envs=7"], ["num_envs is 7", "num_minibatches = 2", "a multiple of 2"]),
        (["--num-envs"], ["--num-envs"]),
        (["--total-timesteps=0"], ["total_timesteps is 0", "at least 1"]),
        (["--num-devices=99"], ["num_devices is 99", "allowed: 0 to"]),
        (["--seed=-1"], ["seed is -1", "at least 0"]),
        (["--num-seeds=0"], ["num_seeds is 0", "at least 1"]),
        (["--learning-rate=nan"], ["learning_rate is nan", "at least 1e-12, at most 10"]),
        (["--lr=-1e-3"], ["learning_rate is -0.001", "at least 1e-12"]),
        (["--gamma=1.5"], ["gamma is 1.5", "at most 1"]),
        (["--gamma=nan"], ["gamma is nan", "at most 1"]),
        (["--clip=0"], ["clip_epsilon is 0.0", "at least 1e-06"]),
        (["--entropy=inf"], ["entropy_coef is inf", "at most 1000000.0"]),
        (["--hidden", "0"], ["hidden is 0", "at least 1"]),
        (["--hidden", "8", "x"], ["hidden is 'x'", "a whole number"]),
        (["--demand-range", "1.5", "0.5"], ["demand_range is 1.5 0.5", "the lower one first"]),
        (["--demand-range", "1"], ["demand_range is 1.0", "two numbers"]),
        (["--demand-range", "-1", "1"], ["demand_range is -1.0", "at least 0"]),
        (["--demand-range", "1", "99"], ["demand_range is 99.0", "at most 4"]),
        (["--demand-range", "nan", "1"], ["demand_range is nan", "at most 4"]),
        (["--demand-range", "few", "1"], ["demand_range is 'few'", "a number"]),
        (["--activation=gelu"], ["activation is 'gelu'", "tanh, relu, silu"]),
        (["--network=transformer"], ["network is 'transformer'", "allowed: ramps, mlp"]),
        (["--eval-episodes=1"], ["eval_episodes is 1", "at least 2"]),
        (["--encoder", "8"], ["network is 'ramps' and encoder is (8,)", "allowed: 64 64"]),
        (
            ["--rule-sharpness=2", "--policy-prior=wait"],
            ["rule_sharpness is 2.0 without a start from the rule", "allowed: 1.0 or 4.0"],
        ),
        (["--rule-sharpness=2", "--observation=flat"], ["rule_sharpness is 2.0", "1.0 or 4.0"]),
        (["--set", "nothing=3"], ["nothing", "allowed", "episode_decisions"]),
        (["--set", "episode_decisions=-3"], ["episode_decisions is -3", "above 0"]),
        (["--set", "episode_decisions=nan"], ["episode_decisions is nan", "above 0"]),
        (["--set", "episode_decisions"], ["--set episode_decisions", "NAME=VALUE"]),
        (["--set", "reward=x"], ["--set reward=x", "NAME=VALUE"]),
        (["--set", "build=3"], ["--set build=3", "NAME=VALUE"]),
        (["--resume=absent"], ["absent", "not a directory"]),
        (["--resume=absent", "--run-dir=new"], ["--run-dir", "one of the two"]),
        (["--resume=absent", "--config=x.json"], ["--config", "one of the two"]),
        (["--config=absent.yaml"], ["absent.yaml", "cannot read"]),
    ],
)
def test_bad_options_of_ppo(probe, capsys, argv, words):
    refused(capsys, TINY + argv, *words)
    assert list(probe.iterdir()) == []


def test_run_dir_in_use_is_refused_and_left_as_it_was(probe, capsys):
    notes = probe / "used" / "notes.txt"
    notes.parent.mkdir()
    notes.write_text("precious")
    words = ("used", "already holds files", "a new or empty directory")
    refused(capsys, [*TINY, "--run-dir=used"], *words)
    assert [*notes.parent.iterdir()] == [notes]
    assert notes.read_text() == "precious"


def test_run_dir_that_cannot_be_written(probe, capsys):
    (probe / "file").write_text("")
    refused(capsys, [*TINY, "--run-dir=file"], "file", "not a directory")
    refused(capsys, [*TINY, "--run-dir=file/run"], "file/run", "allowed: a")
    refused(capsys, [*TINY, "--run-dir=/proc/run"], "/proc/run", "cannot write")
    assert [path.name for path in probe.iterdir()] == ["file"]
    assert (probe / "file").read_text() == ""


def test_bad_settings_are_found_before_the_run_dir_is_made(probe, capsys):
    refused(capsys, [*TINY, "--run-dir=new", "--scenario=nowhere"], "nowhere")
    refused(capsys, [*TINY, "--run-dir=new", "--network=x"], "network")
    assert list(probe.iterdir()) == []


def test_help_lists_every_setting(capsys):
    assert exit_code(ppo, ["--help"]) == 0
    text = capsys.readouterr().out
    for field in dataclasses.fields(PPOConfig):
        name = field.name
        option = "--set" if name == "overrides" else "--" + name.replace("_", "-")
        assert option in text


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ([], ["--run-dir"]),
        (["--run-dir=absent"], ["absent", "not a directory"]),
        (["--run-dir=.", "--episodes=0"], ["--episodes '0'", "from 2"]),
        (["--run-dir=.", "--episodes=x"], ["--episodes 'x'", "a whole number"]),
        (["--run-dir=.", "--seed=-1"], ["--seed '-1'"]),
        (["--run-dir=.", "--batch=0"], ["--batch '0'"]),
        (["--run-dir=.", "--json=absent/file.json"], ["absent/file.json", "can be written"]),
        (["--run-dir=.", "--plot=x.jpg"], ["--plot x.jpg", "ends in .png"]),
        (["--run-dir=.", "--plot=absent/x.png"], ["absent/x.png", "can be written"]),
        (["--run-dir=.", "--json=."], ["is a directory", "allowed a file"]),
        (["--run-dir=."], ["config.json", "cannot read"]),
        (["--run-dir=.", "--only=all"], ["--only"]),
    ],
)
def test_bad_options_of_evaluate(probe, capsys, argv, words):
    refused(capsys, argv, *words, command=evaluate)
    assert list(probe.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.json", "{", ["not a JSON file"]),
        ("a.yaml", "a: [", ["not a YAML file"]),
        ("a.yaml", "a: !!python/object:os.system x", ["not a YAML file"]),
        ("a.yaml", "- 1", ["list", "allowed: an object"]),
        ("a.yaml", "speed: 3", ["'speed' is not a setting"]),
        ("a.yml", "num_envs: many", ["num_envs is 'many'", "a whole number"]),
        ("a.json", '{"config": {"gamma": 2}}', ["gamma is 2", "at most 1"]),
    ],
)
def test_bad_settings_files(probe, capsys, name, text, words):
    (probe / name).write_text(text)
    refused(capsys, [f"--config={name}", "--run-dir=new"], name, *words)
    assert [path.name for path in probe.iterdir()] == [name]


def test_settings_survive_their_file():
    config = PPOConfig(num_envs=32, hidden=(8, 4), overrides={"cooldown_s": 3.5, "ramps": (1, 2)})
    read = from_json(json.loads(json.dumps(to_json(config))), PPOConfig)
    assert dataclasses.replace(read, overrides=config.overrides) == config
    assert from_json({"demand_range": [0, 2]}, PPOConfig).demand_range == (0, 2)
    with pytest.raises(InputError, match="'speed' is not a setting"):
        from_json({"speed": 3}, PPOConfig)


def test_values_of_options():
    argv = ["--num-envs=32e2", "--lr", "1e-3", "--hidden", "8", "16", "--no-anneal"]
    expected = PPOConfig(num_envs=3200, learning_rate=1e-3, hidden=(8, 16), anneal=False)
    assert parse_request(PPOConfig, argv).config == expected
    config = parse_request(PPOConfig, ["--demand-range", "0.5", "2"]).config
    assert config.demand_range == (0.5, 2.0)
    values = {"a": 3, "b.c": 1.5, "d": True, "e": (1, 2), "f": "word"}
    assert parse_overrides(["a=3", "b.c=1.5", "d=true", "e=[1, 2]", "f=word"]) == values


def test_the_parser_needs_no_jax():
    """So --help answers at once."""
    code = """if True:
        import sys
        from train.algorithms.settings import SETTINGS
        from train.runs.arguments import build_parser
        for kind in SETTINGS:
            build_parser(kind)
        sys.exit('jax' in sys.modules)
    """
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
