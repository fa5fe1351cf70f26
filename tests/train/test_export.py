"""The file of a policy against the network that it came from, and the files that are refused."""

import dataclasses
import json
import os
import re
import zipfile

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import medjax
from medjax.charging.link import COUPLINGS
from medjax.commandline import OneLineParser
from medjax.env.charging_env import ChargingEnv
from medjax.env.observation import FlatObservation
from medjax.episodes.options import add_episode_options, requested_episode
from medjax.episodes.recording import record_episode
from medjax.episodes.scores import evaluate_policies
from medjax.errors import InputError
from medjax.policies.about import about_of
from medjax.policies.saved import load_policy
from medjax.traffic.idm import IDM
from medjax.wrappers import RandomDemand
from tests.train.conftest import refused
from train import export
from train.algorithms.networks import PolicyWeights, apply_policy, build_network, learned_policy
from train.algorithms.normalization import init_stats
from train.algorithms.ppo.settings import PPOConfig
from train.runs.policies import export_policy

pytestmark = pytest.mark.usefixtures("quick_compiles")

SMALL = {"num_meds": 3, "num_evs": 8, "num_gas": 12, "episode_decisions": 24}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A network with random weights and clear preferences, and its file."""
    config = PPOConfig(hidden=(16,), overrides=SMALL, decide_every=4, rule_sharpness=4.0)
    env, params = medjax.make("paper", observation=config.observation, **SMALL)
    network = build_network(env, config)
    obs, _ = jax.jit(env.reset)(jax.random.key(0), params)
    variables = network.init(jax.random.key(1), obs[None])
    variables = jax.tree.map(
        lambda leaf: leaf + 0.3 * jnp.cos(jnp.arange(leaf.size)).reshape(leaf.shape), variables
    )
    weights = PolicyWeights(variables, init_stats(obs.shape))
    path = tmp_path_factory.mktemp("policy") / "policy.zip"
    export_policy(path, env, params, config, weights, {})
    return env, params, config, network, weights, path


def test_the_file_names_no_line_of_source(exported):
    with zipfile.ZipFile(exported[-1]) as file:
        assert not re.search(rb"\.py\b|site-packages", file.read("network.bin"))


@pytest.mark.versions
def test_acts_as_the_network_does_outside_jit(exported):
    env, _, _, network, weights, path = exported
    policy = load_policy(path)
    assert dict(policy.about.overrides) == SMALL
    assert policy.about.decide_every == 4
    rng = np.random.default_rng(0)
    obs = rng.normal(size=(7, policy.about.num_features)).astype(np.float32)
    mask = rng.random((7, env.num_actions)) < 0.6
    mask[:, 0] = True
    theirs = np.asarray(apply_policy(network, weights, *map(jnp.asarray, (obs, mask)))[0].probs)
    ours = policy.probabilities(obs, mask)
    assert isinstance(ours, np.ndarray)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert (ours[~mask] == 0.0).all()
    assert (policy.act(obs.tolist(), mask) == theirs.argmax(axis=1)).all()
    np.testing.assert_allclose(policy.probabilities(obs[2], mask[2]), theirs[2], atol=1e-6)


@pytest.mark.thorough
def test_plays_as_the_network_it_came_from(exported):
    """In a comparison on the same episodes, and recorded in the environment that the file rebuilds."""
    env, params, config, network, weights, path = exported
    policy = load_policy(path)
    policies = {
        "saved": policy.policy(env),
        "learned": learned_policy(env, network, weights, config.decide_every),
        "none": medjax.BASELINES["none"](env),
    }
    scores = evaluate_policies(env, params, policies, 4, seed=5)
    for name, values in scores["saved"].items():
        np.testing.assert_allclose(values, scores["learned"][name], rtol=1e-4, err_msg=name)
    assert scores["saved"]["meds_dispatched"].sum() > scores["none"]["meds_dispatched"].sum() == 0

    there, numbers = policy.make()
    decisions = record_episode(there, numbers, policy.policy(there), seed=5, episode=1).decisions
    assert decisions.reward.sum() == pytest.approx(scores["learned"]["return"][1], rel=1e-4)
    assert decisions.stats.meds_dispatched.sum() == scores["learned"]["meds_dispatched"][1] > 0
    assert (np.nonzero(decisions.sent)[0] % 4 == 0).all()
    np.testing.assert_allclose(decisions.probabilities.sum(axis=1), 1.0, atol=1e-5)


def test_is_recorded_in_another_world(exported, monkeypatch):
    """With numbers that override those of its training, by the options that all commands on episodes have."""
    env, *_, path = exported
    parser = OneLineParser()
    add_episode_options(parser)
    given = [f"--policy={path}", "--set", "num_gas=9", "--set", "cooldown_s=7"]
    asked = requested_episode(parser.parse_args(given))
    for there, numbers in (asked.prepared(), asked.build()[:2]):
        assert there.config == dataclasses.replace(env.config, num_gas=9)
        assert numbers.fleet.cooldown_s == 7.0
    assert [*asked.build()[2]] == ["ppo"]
    with pytest.raises(InputError, match="actions: allowed"):
        requested_episode(parser.parse_args([f"--policy={path}", "--set=num_ramps=2"])).build()
    monkeypatch.setattr("medjax.numerics.memory.memory_bytes", lambda: 10_000)
    with pytest.raises(InputError, match="an episode of 24 decisions with 20 vehicles: about"):
        asked.check_memory(*asked.prepared())


def test_an_environment_that_no_file_can_rebuild_is_refused(exported):
    """With custom numbers, rewards or models, or inside a wrapper."""
    env, params, *_ = exported
    about = about_of(env, params, 4)
    again, numbers = medjax.make(about.scenario, observation=about.observation, **about.overrides)
    assert again.config == env.config
    chex.assert_trees_all_equal(numbers, params)
    cases = [
        (env, params.replace(battery_scale=params.battery_scale + 1.0), "changed numbers of paper"),
        (ChargingEnv(env.config, observation=env.observation), params, "charging"),
        (RandomDemand(env, 0.5, 1.5), params, "paper"),
        (*medjax.make("paper", reward={"mine": lambda outcome: 0.0}), "a custom reward"),
        (*medjax.make("paper", observation=FlatObservation()), "a custom observation"),
        (*medjax.make("paper", following=IDM(exponent=2.0)), "a custom following"),
        (*medjax.make("paper", coupling=COUPLINGS["paper"]), "a custom coupling"),
    ]
    for world, given, says in cases:
        with pytest.raises(InputError, match=f"describe {says}: allowed an environment") as refusal:
            about_of(world, given, 4)
        assert "\n" not in str(refusal.value)


@pytest.mark.thorough
def test_vmap_equals_a_loop(exported):
    """Over rows, over rows of rows, and over some of its arguments only."""
    env, params, *_, path = exported
    policy = load_policy(path).policy(env)
    obs, states = jax.jit(jax.vmap(env.reset, (0, None)))(
        jax.random.split(jax.random.key(3), 6), params
    )
    keys = jax.random.split(jax.random.key(4), 6)
    one_by_one = [
        policy(keys[i], obs[i], jax.tree.map(lambda leaf, i=i: leaf[i], states), params)
        for i in range(6)
    ]
    looped = jax.tree.map(lambda *each: jnp.stack(each), *one_by_one)
    rows = jax.vmap(policy, (0, 0, 0, None))
    chex.assert_trees_all_close(rows(keys, obs, states, params), looped, atol=1e-6)
    fold = jax.tree.map(lambda leaf: leaf.reshape(2, 3, *leaf.shape[1:]), (keys, obs, states))
    nested = jax.jit(jax.vmap(rows, (0, 0, 0, None)))(*fold, params)
    flat = jax.tree.map(lambda leaf: leaf.reshape(6, *leaf.shape[2:]), nested)
    chex.assert_trees_all_close(flat, looped, atol=1e-6)
    state = jax.tree.map(lambda leaf: leaf[0], states)
    seen = jax.vmap(policy, (None, 0, None, None))(keys[0], obs, state, params)
    np.testing.assert_allclose(seen.probabilities[0], looped.probabilities[0], atol=1e-6)
    assert len(np.unique(seen.probabilities, axis=0)) == 6


def test_another_shape_is_refused(exported):
    policy = load_policy(exported[-1])
    with pytest.raises(ValueError, match=r"obs has shape \(3,\).*allowed"):
        policy.act(np.zeros(3), np.ones(5, bool))
    size, actions = policy.about.num_features, policy.about.num_actions
    for obs in (np.full(size, np.nan), "x", [[1.0], [1.0, 2.0]], None):
        with pytest.raises(InputError, match=r"obs = .*: allowed finite numbers"):
            policy.act(obs, np.ones(actions, bool))
    none = np.zeros((0, size)), np.zeros((0, actions))
    assert policy.probabilities(*none).shape == (0, actions)
    assert policy.act(*none).shape == (0,)
    for given, words in ((3, "overrides are 3"), ({"name": "x"}, "overrides hold name")):
        with pytest.raises(InputError, match=words):
            policy.make(overrides=given)
    with pytest.raises(InputError, match="env is 3: allowed an environment"):
        policy.policy(3)
    env, _ = medjax.make("paper", **SMALL | {"num_ramps": 2})
    with pytest.raises(ValueError, match="3 actions: allowed"):
        policy.policy(env)


def test_a_foreign_file_is_refused(exported, tmp_path):
    good = exported[-1].read_bytes()
    for name, data in (("cut", good[: len(good) // 2]), ("text", b"hello"), ("empty", b"")):
        (tmp_path / f"{name}.zip").write_bytes(data)
    for name, about in (("later", '{"format": 99}'), ("broken", '{"format": 1, "wheels": 4}')):
        with zipfile.ZipFile(tmp_path / f"{name}.zip", "w") as file:
            file.writestr("policy.json", about)
    for name in ("cut", "text", "empty", "broken", "absent"):
        with pytest.raises(ValueError, match=rf"{name}.zip.* allowed: a policy"):
            load_policy(tmp_path / f"{name}.zip")
    with pytest.raises(ValueError, match="format 99, allowed: 1"):
        load_policy(tmp_path / "later.zip")


def test_a_file_that_was_changed_is_refused(exported, tmp_path):
    """Other bytes of the network under a right checksum, a file that unpacks to too much, a pipe: one line each."""
    with zipfile.ZipFile(exported[-1]) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    rng = np.random.default_rng(0)
    path = tmp_path / "changed.zip"

    def write(**changed):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            for name, data in parts.items():
                file.writestr(name, changed.get(name.partition(".")[0], data))

    refusals = []
    for _ in range(40):
        network = bytearray(parts["network.bin"])
        start = rng.integers(len(network))
        network[start : start + 16] = rng.bytes(16)
        write(network=bytes(network))
        try:  # a changed weight is still a weight
            load_policy(path)
        except InputError as refusal:
            refusals.append(str(refusal))
    assert refusals
    assert not any("\n" in line for line in refusals)
    about = json.loads(parts["policy.json"])
    write(policy=json.dumps(about | {"num_actions": about["num_actions"] + 1}))
    with pytest.raises(InputError, match="network that cannot be read"):
        load_policy(path)
    for field, value in {
        "overrides": 3,
        "decide_every": 0,
        "num_features": True,
        "name": "a\nb",
        "agents": {"build": 3},
        "dispatcher": "nobody",
        "training": None,
    }.items():
        write(policy=json.dumps(about | {field: value}))
        with pytest.raises(InputError, match="cannot be read"):
            load_policy(path)
    write(policy=b" " * (2**20 + 1))
    with pytest.raises(InputError, match=r"policy.json of 1048577 bytes: at most 1048576"):
        load_policy(path)
    os.mkfifo(tmp_path / "pipe.zip")
    with pytest.raises(InputError, match="is not a file"):
        load_policy(tmp_path / "pipe.zip")


@pytest.mark.parametrize(
    ("argv", "words"), [(["--run-dir=absent"], ["absent", "not a directory"]), ([], ["--run-dir"])]
)
def test_bad_options(argv, words, capsys):
    line = refused(capsys, argv, *words, command=export)
    assert line.startswith("python -m train.export: ")
