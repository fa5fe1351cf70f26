"""Training and evaluation from Python: as the commands do, also in environments that these cannot name."""

import dataclasses
import json
import math
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from medjax.errors import InputError
from medjax.policies.saved import load_policy
from tests.train.conftest import TINY, make_probe, refused
from tests.train.own_parts import Generous
from tests.train.probe_envs import ProbeParams
from tests.train.runs.test_session import assert_same_run, rows_of
from train import evaluate as evaluate_command
from train import export, ppo
from train.algorithms.ppo.settings import PPOConfig
from train.api import StoppedError, evaluate, train
from train.runs.arguments import parse_request
from train.runs.checkpoint import Checkpoints
from train.runs.logs import read_rows


@pytest.fixture
def config():
    """The settings of `TINY`, as Python gives them."""
    return parse_request(PPOConfig, TINY).config


OWN = Generous("noisy")


@pytest.mark.thorough
def test_training_from_python_equals_the_command(probe, config):
    """Bit for bit, with all its files; the callback and the result have the rows, without padding or NaN."""
    rows = []
    ours = train("noisy", config=config, run_dir="ours", callback=rows.append)
    assert ppo.main([*TINY, "--run-dir=theirs"]) == 0
    assert_same_run(probe / "ours", probe / "theirs")
    names = [{path.name for path in (probe / name).iterdir()} for name in ("ours", "theirs")]
    assert names[0] == names[1] >= {"config.json", "policy.zip", "evaluation.json", "plots"}
    assert len(repr(ours)) < 2000  # a notebook shows it
    assert rows == ours.rows == read_rows(probe / "ours" / "metrics.jsonl")
    assert [row["update"] for row in ours.rows] == [1, 2, 3, 4, 5, 6]
    numbers = [value for row in rows for value in row.values() if value is not None]
    assert all(map(math.isfinite, numbers))
    assert ours.run_dir == (probe / "ours").relative_to(probe)
    assert ours.evaluation.result == json.loads((probe / "theirs/evaluation.json").read_text())
    obs, state = jax.jit(ours.env.reset)(jax.random.key(0), ours.params)
    assert ours.policy(jax.random.key(1), obs, state, ours.params).action in (0, 1)


@pytest.mark.thorough
def test_a_custom_environment(probe, config, capsys):
    """The commands refuse its run in a line, Python resumes it, and its policy plays in it."""
    ours = train(OWN, ProbeParams(), config, run_dir="mine")
    assert "3 whole episodes of noisy-own of seed 0" in capsys.readouterr().out
    assert ours.evaluation.result["policies"]["none"]["return_mean"] > 50.0
    for command, argv in (
        (ppo, ["--resume=mine", "--total-timesteps=128"]),
        (ppo, ["--config=mine/config.json"]),
        (evaluate_command, ["--run-dir=mine", "--episodes=3"]),
        (export, ["--run-dir=mine"]),
    ):
        refused(capsys, argv, "given from Python", "train.api", command=command)
    saved = load_policy("mine/policy.zip")
    with pytest.raises(InputError, match="trained in a custom environment: allowed that one"):
        saved.make()
    played = evaluate(OWN, ProbeParams(), {"saved": saved, "ours": ours.policy}, episodes=3)
    np.testing.assert_array_equal(*(scores["return"] for scores in played.scores.values()))
    more = dataclasses.replace(config, total_timesteps=128, eval_episodes=0)
    again = train(OWN, ProbeParams(), more, resume="mine", quiet=True)
    assert len(again.rows) == len(rows_of(probe / "mine")) == 8
    assert again.evaluation is None


def test_settings_name_an_environment_as_make_gives_it(probe, config):
    """Its run is one that the commands take."""
    env, params = make_probe("noisy", observation="profile", episode_decisions=7)
    # The environment overrides these settings.
    other = dataclasses.replace(config, eval_episodes=0, reward="money", wrapper="nobodys:own")
    train(env, params, other, run_dir="named", quiet=True)
    saved = json.loads((probe / "named/config.json").read_text())
    assert saved["config"]["overrides"] == {"episode_decisions": 7}
    assert (saved["config"]["reward"], saved["config"]["wrapper"]) == ("preset", "none")
    assert "environment" not in saved
    assert evaluate_command.main(["--run-dir=named", "--episodes=3"]) == 0


def test_paired_differences_from_any_policy(probe):
    """Of a function and of a rule, from a baseline; as rows, as episodes and as the command's table."""

    def mine(key, obs, state, params):
        return jnp.int32(1)

    played = evaluate(
        "noisy", None, {"mine": mine, "random": "random"}, baseline="none", episodes=5
    )
    gains = {
        name: score["return"] - played.scores["none"]["return"]
        for name, score in played.scores.items()
    }
    np.testing.assert_allclose(gains["mine"], 5.0, rtol=1e-5)  # one more in each of five decisions
    rows = {row["policy"]: row for row in played.rows()}
    assert rows["mine"]["minus_none"] == pytest.approx(5.0, rel=1e-5)
    assert rows["random"]["minus_none"] == pytest.approx(gains["random"].mean())
    low, high = (rows["random"][f"minus_none_ci95_{end}"] for end in ("low", "high"))
    assert low <= rows["random"]["minus_none"] <= high
    assert "minus_none" not in rows["none"]
    assert all(np.isscalar(value) for row in played.rows() for value in row.values())
    each = [row for row in played.episodes() if row["policy"] == "random"]
    assert [row["return"] for row in each] == pytest.approx(played.scores["random"]["return"])
    table = str(played)
    assert repr(played) == table
    assert table.startswith("5 whole episodes of noisy of seed 0, the same for every policy")
    assert "minus none, 95 % CI" in table


@pytest.mark.parametrize(
    ("words", "call"),
    [
        ("env without params", lambda config: train(OWN, None, config)),
        ("params without an environment", lambda config: train("noisy", ProbeParams(), config)),
        ("params are PPOConfig: allowed config=PPOConfig", lambda config: train("noisy", config)),
        ("env is 3", lambda config: train(3, ProbeParams(), config)),
        ("config is {'seed': 1}, allowed: settings", lambda _: train("noisy", None, {"seed": 1})),
        ("callback is 3, allowed: a function", lambda config: train(config=config, callback=3)),
        ("resume 'run/3.npz': allowed a run's directory", lambda _: train(resume="run/3.npz")),
        ("a run's directory, or its check", lambda _: train(resume="run/checkpoints/x.npz")),
        ("run_dir 3: allowed a path", lambda config: train("noisy", None, config, run_dir=3)),
        ("run_dir '': allowed a path", lambda config: train("noisy", None, config, run_dir="")),
        ("printable characters", lambda config: train("noisy", None, config, run_dir="a\0b")),
        ("resume b'run': allowed a path", lambda config: train(config=config, resume=b"run")),
        ("allowed: one", lambda config: train("noisy", None, config, run_dir="a", resume="b")),
        ("episodes is 1, .* at least 2", lambda _: evaluate("noisy", episodes=1)),
        ("episodes is 1000.0", lambda _: evaluate("noisy", episodes=1e3)),
        ("at most 10000000", lambda _: evaluate("noisy", episodes=10**8)),
        ("seed is -1, must be a whole number", lambda _: evaluate("noisy", seed=-1)),
        ("seed is nan", lambda _: evaluate("noisy", seed=math.nan)),
        ("at most 4294967295", lambda _: evaluate("noisy", seed=2**32)),
        ("env without params", lambda _: evaluate(OWN, None, ["none"])),
        ("policies are 3", lambda _: evaluate("noisy", None, 3)),
        ("policies are 'none', allowed: by name", lambda _: evaluate("noisy", None, "none")),
        ("policies are {3: 'none'}", lambda _: evaluate("noisy", None, {3: "none"})),
        ("policy is 3", lambda _: evaluate("noisy", None, {"mine": 3})),
        ("unknown policy 'all'", lambda _: evaluate("noisy", None, ["all"])),
        ("at least one", lambda _: evaluate("noisy", None, {})),
        (r"baseline \[\]: allowed none", lambda _: evaluate("noisy", None, ["none"], baseline=[])),
        ("baseline 'x'", lambda _: evaluate("noisy", None, ["none"], baseline="x")),
    ],
)
def test_bad_arguments_are_refused(probe, config, words, call):
    with pytest.raises(InputError, match=words) as refusal:
        call(config)
    assert "\n" not in str(refusal.value)
    assert list(probe.iterdir()) == []


def test_jax_is_prepared_first_and_no_rule_may_fit(probe, monkeypatch):
    """JAX uses all cores only if it is prepared before anything is made."""
    done = []
    monkeypatch.setattr("train.api.prepare_jax", lambda messages: done.append(messages))
    monkeypatch.setattr("train.api.rules_of", lambda env: done.append("rules") or {})
    with pytest.raises(InputError, match="policies are empty, allowed: at least one"):
        evaluate(OWN, ProbeParams())
    assert done == [False, "rules"]


@pytest.mark.thorough
def test_resumes_from_an_older_checkpoint(probe, config):
    """As --from-update N; later ones are removed. A refusal does not keep the directory locked."""
    config = dataclasses.replace(config, eval_episodes=0, anneal=False, updates_per_call=1)
    train("noisy", None, config, run_dir="whole", quiet=True)
    train("noisy", None, config, run_dir="run", quiet=True)
    refusals = []
    for update, words in (
        (3, "no checkpoint of update 3 is there, allowed: 2, 4, 6"),
        (6, "has done its 96"),
    ):
        with pytest.raises(InputError, match=words) as refusal:
            train(config=config, resume=f"run/checkpoints/{update}.npz", quiet=True)
        refusals.append(refusal)  # whose frames live on, as in a notebook
    again = train(config=config, resume="run/checkpoints/4.npz", quiet=True)
    assert [row["update"] for row in again.rows] == [1, 2, 3, 4, 5, 6]
    assert_same_run(probe / "whole", probe / "run")


@pytest.mark.thorough
def test_a_longer_run_goes_on_from_the_rule_that_its_weights_add_to(probe, config):
    """Its length alone would choose a softer one; another number that is given is refused."""
    config = dataclasses.replace(config, eval_episodes=0)
    first = train("noisy", None, config, run_dir="run", quiet=True)
    assert first.config.rule_sharpness == 4.0
    longer = dataclasses.replace(config, total_timesteps=10**5)
    length = int(first.params.episode_decisions)
    assert longer.for_episodes(length).rule_sharpness == 1.0

    def stop(row):
        raise StopIteration

    with pytest.raises(InputError, match=r"rule_sharpness 1.0, which was 4.0 until now"):
        train(config=dataclasses.replace(longer, rule_sharpness=1.0), resume="run", quiet=True)
    with pytest.raises(StopIteration):
        train(config=longer, resume="run", quiet=True, callback=stop)
    kept = json.loads((probe / "run/config.json").read_text())["config"]
    assert (kept["rule_sharpness"], kept["total_timesteps"]) == (4.0, 10**5)


def test_a_run_that_fails_before_its_start_leaves_nothing(probe, config):
    """A custom environment that fails when it is traced; its directory is free for the next trial."""

    class Broken(Generous):
        """A mistake in a step."""

        def step_env(self, key, state, action, params):
            raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        train(Broken("noisy"), ProbeParams(), config, run_dir="mine", quiet=True)
    assert list(probe.iterdir()) == []


@pytest.mark.thorough
def test_what_ends_a_run_early_is_raised(probe, config):
    """A number that is not finite as StoppedError, and an exception of the callback, an OSError as a RuntimeError."""

    def breaks(row):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        train("noisy", None, config, run_dir="one", callback=breaks, quiet=True)

    def forbids(row):
        raise PermissionError("mine")

    with pytest.raises(RuntimeError, match="the callback failed: mine"):
        train("noisy", None, config, run_dir="four", callback=forbids, quiet=True)
    with pytest.raises(StoppedError, match="rewards no longer finite in update 1: stopped"):
        train(OWN, ProbeParams(reward=math.nan), config, run_dir="two", quiet=True)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("number", "raised", "said"),
    [
        (signal.SIGINT, KeyboardInterrupt, "after update 1, saved"),
        (signal.SIGTERM, SystemExit, "^143$"),
    ],
)
def test_a_signal_saves_the_state_and_is_raised(probe, config, number, raised, said):
    def asks(row):
        signal.raise_signal(number)

    one = dataclasses.replace(config, updates_per_call=1)
    with pytest.raises(raised, match=said) as stop:
        train("noisy", None, one, run_dir="run", callback=asks, quiet=True)
    assert raised is KeyboardInterrupt or stop.value.code == 143
    assert len(rows_of(probe / "run")) == 1
    assert Checkpoints(probe / "run").latest() == 1


def test_a_wrapper_by_its_name(probe, capsys):
    """Settings rebuild it; the file of a policy cannot describe it."""
    argv = [*TINY, "--wrapper=tests.train.own_parts:generous", "--run-dir=run"]
    assert ppo.main(argv) == 0
    assert evaluate_command.main(["--run-dir=run", "--episodes=3", "--json=out.json"]) == 0
    played = json.loads((probe / "out.json").read_text())
    assert played["policies"]["none"]["return_mean"] > 50.0
    assert "(wrapper = 'tests.train.own_parts:generous') of seed 0" in capsys.readouterr().out
    assert load_policy("run/policy.zip").about.scenario == ""
    capsys.readouterr()
    for option in ("wrapper", "reward"):
        for text in ("nowhere:wrap", "tests.train.own_parts:gone", "tests.train.own_parts:1x"):
            refused(capsys, [*TINY, f"--{option}={text}"], f"{option} '{text}'")
    refused(capsys, [*TINY, "--wrapper=builtins:repr"], "env is")
    for text in ("os:getcwd", "builtins:dict"):
        said = f"wrapper '{text}' failed to build: TypeError: "
        assert said in refused(capsys, [*TINY, f"--wrapper={text}"])
    words = "agents is 'ippo' and wrapper is 'x:y', allowed: none"
    refused(capsys, [*TINY, "--wrapper=x:y", "--agents=ippo"], words)


@pytest.mark.parametrize(
    ("terms", "name"),
    [
        ("tests.train.own_parts:served,tests.train.own_parts:served", "served"),
        ("tests.train.own_parts:soc", "soc"),  # the preset has a term of this name
    ],
)
def test_two_reward_terms_of_a_name_are_refused(probe, capsys, terms, name):
    """One would be paid in place of the other."""
    line = refused(capsys, [*TINY, f"--reward={terms}"])
    assert f"there are two terms '{name}', allowed: one of a name" in line
