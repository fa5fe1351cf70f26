"""Agents trained by the command: settings, evaluation, and the policy's file."""

import json

import jax
import numpy as np
import pytest

import medjax
from medjax.agents import agents_of
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from medjax.policies.saved import load_policy
from tests.train.conftest import refused
from train import evaluate, ppo
from train.algorithms.environments import described, make_environment
from train.algorithms.ppo.settings import PPOConfig
from train.runs.policies import load_policies
from train.runs.run_directory import RunDir
from train.settings import DISPATCHERS

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"size": 2, "num_evs": 6, "num_gas": 12, "mainline_per_h": 900.0, "episode_decisions": 12}
TINY = ["--num-envs=4", "--num-minibatches=4", "--rollout-length=12", "--total-timesteps=96"]


@pytest.mark.parametrize(
    "argv",
    [
        pytest.param(["--agents=ippo", "--credit=own"], marks=pytest.mark.slow),
        pytest.param(
            ["--agents=mappo", "--credit=own", "--dispatcher=budgeted"], marks=pytest.mark.thorough
        ),
    ],
)
def test_train_evaluate_and_export(tmp_path, argv):
    """Rules play as dispatchers of the same world; the file's policy is the run's, including its dispatcher."""
    run = tmp_path / "run"
    closes = argv[-1] == "--dispatcher=budgeted"  # with an evaluation of all rules
    episodes = f"--eval-episodes={2 * closes}"
    changes = [f"--set={name}={value}" for name, value in SMALL.items()]
    assert ppo.main([*TINY, *argv, "--hidden", "8", f"--run-dir={run}", episodes, *changes]) == 0
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [row["update"] for row in rows] == [1, 2]
    assert rows[-1]["episode_length"] == 12.0
    out = tmp_path / "out.json"
    played = [] if closes else ["--policies=ppo,budgeted", "--baseline=budgeted"]
    assert evaluate.main([f"--run-dir={run}", "--episodes=2", f"--json={out}", *played]) == 0
    result = json.loads(out.read_text())
    by_rule = result["policies"]["budgeted"]
    assert result["policies"]["ppo"]["invalid_actions"] == 0.0
    if closes:
        assert result == json.loads((run / "evaluation.json").read_text())
        assert result["policies"]["ppo"]["meds_dispatched"] == pytest.approx(
            by_rule["meds_dispatched"], abs=1
        )

    env, _, policies = load_policies(run, RunDir(run).load_config())
    saved = load_policy(run / "policy.zip")
    with pytest.raises(InputError, match="speeds is fixed by the policy"):
        saved.make(overrides={"speeds": [14.0]})
    again, numbers = saved.make()
    assert (again.num_agents, again.actions) == (env.num_agents, env.actions)
    play = {"run": policies["ppo"], "file": saved.policy(env)}
    scores = evaluate_policies(again, numbers, play, 2, seed=7)
    for name, values in scores["run"].items():
        np.testing.assert_allclose(scores["file"][name], values, rtol=1e-5, err_msg=name)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--agents=both"], ["agents", "both", "none, ippo, mappo"]),
        (["--agents=ippo", "--credit=mine"], ["credit", "mine", "team, own"]),
        (["--agents=ippo", "--dispatcher=nobody"], ["dispatcher", "nobody", "agents, periodic"]),
        (["--dispatcher=budgeted"], ["agents is 'none'", "dispatcher is 'budgeted'"]),
        (["--credit=own"], ["agents is 'none'", "credit is 'own'"]),
        (["--agents=ippo", "--network=sets"], ["network", "sets"]),
        (
            ["--agents=ippo", "--observation=flat"],
            ["agents is 'ippo' and observation is 'flat', allowed: profile"],
        ),
        (
            ["--agents=mappo", "--decide-every=2"],
            ["decide_every is 2, allowed: 1"],
        ),
        (["--agents=mappo", "--normalize-observations"], ["agents", "normalize_observations"]),
        (["--agents=ippo", "--set=size=0"], ["num_meds"]),
        (["--agents=ippo", "--set=speeds=3"], ["speeds = 3", "a list of speeds"]),
        (["--agents=ippo", "--set=credit=own"], ["credit=own", "the name of a number"]),
        (["--agents=ippo", "--set=central=1"], ["central=1", "the name of a number"]),
    ],
)
def test_bad_input_is_one_line(tmp_path, monkeypatch, capsys, argv, words):
    monkeypatch.chdir(tmp_path)
    refused(capsys, argv, *words)
    assert not any(tmp_path.iterdir())


def test_dispatchers_are_deterministic_rules():
    """Each is one of `medjax.BASELINES`, ignores its key, and leaves the numbers of the world alone."""
    env, params = medjax.make("paper", **SMALL)
    obs, state = jax.jit(env.reset)(jax.random.key(0), params)
    policies = {name: medjax.BASELINES[name](env) for name in DISPATCHERS}
    acts = jax.jit(lambda key: {n: p(key, obs, state, params).action for n, p in policies.items()})
    assert acts(jax.random.key(1)) == acts(jax.random.key(2))
    assert all(policy.params_transform(params) is params for policy in policies.values())


@pytest.mark.parametrize("central", [False, True])
def test_settings_name_given_agents(central):
    """As `agents_of` makes them, so that `train.api` leaves a run that the commands take."""
    env, params = agents_of("paper", central=central, credit="own", speeds=[17.0], **SMALL)
    # Settings of another observation say nothing of agents.
    config, rebuilt = described(env, params, PPOConfig(observation="flat"))
    assert rebuilt
    assert config.observation == "profile"
    assert config.agents == ("mappo" if central else "ippo")
    assert config.for_episodes(150).total_timesteps == 500_000  # not a dispatcher's ten million
    # Numbers of one's own cannot be rebuilt, but agents remain agents.
    doubled = jax.tree.map(lambda leaf: leaf * 2, params.fleet)
    flat = PPOConfig(observation="flat")
    own, rebuilt = described(env, params.replace(fleet=doubled), flat)
    assert (rebuilt, own.scenario, own.agents) == (False, "paper-own", config.agents)
    again, numbers = make_environment(config)
    assert (again.actions, again.view, again.credit) == (env.actions, env.view, "own")
    assert again.config == env.config
    jax.tree.map(np.testing.assert_array_equal, numbers, params)
