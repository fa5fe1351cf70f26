"""The weights of a run, in its own world and in others."""

import dataclasses

import chex
import jax
import numpy as np
import pytest

import medjax
from medjax.env.reward import TERMS
from medjax.errors import InputError
from medjax.policies.pretrained import FILES
from medjax.scenarios import prepare
from train import evaluate
from train.algorithms import environments
from train.algorithms.algorithm import TrainState
from train.algorithms.ppo.settings import PPOConfig
from train.runs.checkpoint import Checkpoints
from train.runs.policies import check_rule, chosen, load_weights, make_world, weight_shapes
from train.runs.run_directory import RunDir
from train.runs.trained_run import to_play


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run with the default settings and weights of ones; its environments compute no coils."""
    make = lambda config: environments._build(prepare, config)[:2]  # noqa: E731
    monkeypatch.setattr("train.runs.policies.make_environment", make)
    run, config = RunDir(tmp_path / "run"), PPOConfig().for_episodes(600)
    run.claim(config).close()
    shapes = weight_shapes(*make(config), config)
    weights = jax.tree.map(lambda leaf: np.ones(leaf.shape, leaf.dtype), shapes)
    state = TrainState(weights, rollout=None, key=None, update=np.int32(1))
    Checkpoints(run.path).save(state, config)
    return run, weights


def test_worlds_that_leave_the_sizes_alone_fit(run):
    run, weights = run
    for scenario, changes in (
        (None, {}),
        (None, {"cooldown_s": 30}),
        ("realistic", {}),  # which has as many ramps
    ):
        env, _, found = load_weights(run.path, to_play(run.load_config(), scenario, changes))
        chex.assert_trees_all_equal(found, weights)
        assert env.name == (scenario or "paper")


def test_a_world_of_another_shape_is_named_as_it_was_asked_for(run):
    """By the number of --set or the preset, not only by the arrays of the network."""
    run, _ = run
    for scenario, changes, words in (
        (None, {"num_ramps": 3}, "of another shape than paper num_ramps=3, .* on paper "),
        ("corridor", {}, "of another shape than corridor, .* on paper "),
    ):
        with pytest.raises(InputError, match=words) as refusal:
            load_weights(run.path, to_play(run.load_config(), scenario, changes))
        assert "\n" not in str(refusal.value)


def test_weights_that_add_to_a_rule_are_not_added_to_that_of_another_preset():
    """`freight` has numbers of its own for the rule, with whatever reward; all other presets share theirs."""
    config = PPOConfig(scenario="freight").for_episodes(360)
    make = lambda name, **own: medjax.make(name, observation="profile", **own)[0]  # noqa: E731
    freight, corridor, paper = map(make, ("freight", "corridor", "paper"))
    check_rule(config, freight, config)
    check_rule(config, make("freight", reward={"mine": TERMS["soc"]}), config)
    for env in (corridor, paper):
        elsewhere = dataclasses.replace(config, scenario=env.name)
        with pytest.raises(
            InputError, match=f"'{env.name}': the run's weights add to the rule .* fr"
        ):
            check_rule(config, env, elsewhere)
        # A policy that did not start from the rule may go anywhere, and so may one of one's own environment.
        check_rule(config, env, dataclasses.replace(elsewhere, policy_prior="wait"))
        check_rule(dataclasses.replace(config, scenario="freight-own"), env, elsewhere)
    of_paper = dataclasses.replace(config, scenario="paper")
    check_rule(of_paper, corridor, dataclasses.replace(config, scenario="corridor"))
    with pytest.raises(InputError, match=r"'freight': the run's weights add to .* tuned on paper"):
        check_rule(of_paper, freight, config)


def test_a_damaged_checkpoint_is_named_in_any_world(run):
    run, _ = run
    (run.path / "checkpoints" / "1.npz").write_bytes(b"")
    for scenario, changes in ((None, {"cooldown_s": 30}), ("realistic", {})):
        with pytest.raises(InputError, match=r"1.npz is damaged"):
            load_weights(run.path, to_play(run.load_config(), scenario, changes))


def test_a_run_is_a_policy_beside_others(tmp_path, monkeypatch):
    """`run:DIR` in `train.evaluate --policies`; the run sets the world."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/policy.zip").write_bytes((FILES / "paper.zip").read_bytes())
    names = ["forecast", "run:mine"]
    env, _, config = make_world(names, None, {})
    assert config.scenario == "paper"
    assert [*chosen(env, {}, names, "run:mine")] == names
    with pytest.raises(InputError, match="run absent is not a directory"):
        make_world(["run:absent"], None, {})


def test_a_baseline_sets_the_world(tmp_path, monkeypatch):
    """Where no other policy does; its file is of `corridor`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/policy.zip").write_bytes((FILES / "corridor.zip").read_bytes())
    worlds = []

    def keep(names, *rest):
        worlds.append(make_world(names, *rest)[2].scenario)
        raise InputError("known")

    monkeypatch.setattr("train.runs.policies.make_world", keep)
    for policies in ("none", "none,run:mine"):
        assert evaluate.main([f"--policies={policies}", "--baseline=run:mine"]) == 2
    assert evaluate.main(["--policies=none"]) == 2
    assert worlds == ["corridor", "corridor", "paper"]
