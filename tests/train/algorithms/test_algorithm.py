"""What runs need of an algorithm: one that learns nothing is trained, resumed and evaluated under its own name."""

import dataclasses
import json
from typing import ClassVar

import chex
import jax
import jax.numpy as jnp
import pytest

from medjax.errors import InputError
from medjax.numerics.devices import environment_mesh, on_devices
from tests.train.conftest import refused
from tests.train.probe_envs import Probe, ProbeParams
from train import evaluate, ppo
from train.algorithms.algorithm import Algorithm, TrainState, first_weights
from train.algorithms.environments import training_batch
from train.algorithms.finite import BAD, QUANTITIES, first_bad
from train.algorithms.networks import build_network
from train.algorithms.ppo.settings import PPOConfig
from train.algorithms.programs import make_train, shapes_of
from train.algorithms.registry import ALGORITHMS
from train.algorithms.rollout import Collector, episode_metrics
from train.algorithms.settings import SETTINGS
from train.runs.arguments import parse_request
from train.runs.open_session import open_session
from train.runs.policies import weight_shapes
from train.settings import TrainConfig, from_json, to_json


@dataclasses.dataclass(frozen=True)
class StillConfig(TrainConfig):
    """Without settings of its own."""

    algorithm: ClassVar[str] = "still"
    choices_per_update: ClassVar[int] = 4


@dataclasses.dataclass(frozen=True)
class Still:
    """Acts, and learns nothing."""

    collector: Collector
    config: StillConfig
    mesh: jax.sharding.Mesh
    state: ClassVar[type[TrainState]] = TrainState

    def init(self, key, env_params):
        keys = jax.random.split(key, self.config.num_envs)
        rollout = on_devices(self.mesh, self.collector.start)(keys, env_params)
        weights = first_weights(self.collector.network, key, rollout.obs.shape[1:])
        return TrainState(weights, rollout, key, jnp.int32(0))

    def update(self, state, env_params):
        def collect(rows, same):
            return self.collector.collect(same[0], *rows, same[1])

        use, key = jax.random.split(state.key)
        keys = jax.random.split(use, self.config.num_envs)
        shared = on_devices(self.mesh, collect, out_axes=(0, 1, 0, 0))
        rollout, trajectory, _, sums = shared((state.rollout, keys), (state.weights, env_params))
        metrics = {
            "reward_mean": trajectory.reward.mean(),
            **episode_metrics(sums),
            BAD: first_bad(rewards=trajectory.reward),
        }
        return state.replace(rollout=rollout, key=key, update=state.update + 1), metrics


def build(env, params, config):
    mesh = environment_mesh(config.device_groups, config.num_devices, jax.devices())
    batch, network = training_batch(env, params, config), build_network(env, config)
    return Still(Collector(batch, network, config.choices_per_update, 1.0), config, mesh)


STILL = ["--scenario=noisy", "--num-envs=4", "--decide-every=1", "--hidden", "4"]
STILL += ["--eval-episodes=3", "--run-dir=run"]


@pytest.fixture
def still(probe, monkeypatch):
    monkeypatch.setitem(ALGORITHMS, "still", Algorithm(StillConfig, build_network, build))
    monkeypatch.setattr("train.runs.run_directory.SETTINGS", (*SETTINGS, StillConfig))
    return probe


def train(argv):
    return open_session(parse_request(StillConfig, argv)).run()


@pytest.mark.thorough
def test_another_algorithm_trains_by_the_same_runs(still, capsys):
    assert train([*STILL, "--total-timesteps=64"]) == 0
    run = still / "run"
    assert "STILL" not in (out := capsys.readouterr().out)
    assert "4 updates of 4 x 4 choices" in out
    assert json.loads((run / "config.json").read_text())["config"]["algorithm"] == "still"
    summary = json.loads((run / "summary.json").read_text())
    assert summary["env_steps"] == 64
    learned = {"still", "still_sampled", "start", "start_sampled"}
    assert set(summary["evaluation_return_mean"]) == {*learned, "none", "random"}
    assert train(["--resume=run", "--total-timesteps=128"]) == 0
    assert evaluate.main(["--run-dir=run", "--episodes=3", "--json=out.json"]) == 0
    played = json.loads((still / "out.json").read_text())["policies"]
    assert played["still"] == played["start"]  # it learned nothing
    assert played["still_sampled"] == played["start_sampled"]
    capsys.readouterr()
    refused(capsys, ["--resume=run"], "algorithm is 'still'", "allowed: ppo", command=ppo)


def test_the_file_of_a_run_names_its_algorithm():
    kinds = (PPOConfig, StillConfig)
    for config in (PPOConfig(seed=3), StillConfig(seed=3)):
        assert from_json(to_json(config), *kinds) == config
    assert from_json({"gamma": 0.5}, *kinds) == PPOConfig(gamma=0.5)  # the default
    with pytest.raises(InputError, match="'gamma' is not a setting"):
        from_json({"algorithm": "still", "gamma": 0.5}, *kinds)
    for name in ("dqn", 3, None):
        with pytest.raises(InputError, match=r"algorithm is .*, allowed: ppo, still"):
            from_json({"algorithm": name}, *kinds)


@pytest.mark.parametrize("seeds", [1, 2])
def test_shapes_of_weights_are_those_of_training(seeds):
    env, params = Probe("noisy"), ProbeParams()
    config = PPOConfig(num_envs=4, num_minibatches=2, hidden=(4,), num_seeds=seeds)
    expected = shapes_of(make_train(env, params, config), params, config).weights
    chex.assert_trees_all_equal_shapes_and_dtypes(weight_shapes(env, params, config), expected)


def test_the_first_quantity_that_is_not_finite_is_found():
    good, bad = jnp.ones(3), {"a": jnp.ones(2), "b": jnp.array([1.0, jnp.nan])}
    assert QUANTITIES[int(first_bad(rewards=good, loss=bad, optimizer_state=bad))] == "loss"
    assert QUANTITIES[int(first_bad(rewards=good, optimizer_state=bad))] == "optimizer state"
    assert int(first_bad(rewards=good, loss=good)) == len(QUANTITIES)
