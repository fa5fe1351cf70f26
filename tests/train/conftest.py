"""The commands, on a probe environment."""

import jax
import jax.numpy as jnp
import pytest

from medjax.policies.policy import rule
from medjax.scenarios import Recipe
from tests.train.probe_envs import Probe, ProbeParams

TINY = [
    "--scenario=noisy",
    "--num-envs=4",
    "--num-minibatches=2",
    "--decide-every=1",
    "--rollout-length=4",
    "--hidden",
    "4",
    "--eval-episodes=3",
    "--checkpoint-interval=2",
    "--total-timesteps=96",  # 6 updates
]


def make_probe(name="noisy", observation=None, **overrides):
    """Stands in for medjax.make."""
    if name not in ("noisy", "follow"):
        raise ValueError(f"unknown scenario {name!r}: allowed follow, noisy")
    for option, value in overrides.items():
        if option not in ("episode_decisions", "reward"):
            raise ValueError(f"unknown option {option!r}: allowed episode_decisions, reward")
        if not isinstance(value, int | float) or not 0 < value < 100:
            raise ValueError(f"{option} is {value}, allowed: above 0, below 100")
    recipe = Recipe(name, overrides, None, observation)
    return Probe(name, recipe=recipe), ProbeParams(**overrides)


def never(env):
    return rule(lambda key, state, params: jnp.int32(0), env.num_actions)


def coin(env):
    return rule(
        lambda key, state, params: jax.random.randint(key, (), 0, 2, jnp.int32), env.num_actions
    )


@pytest.fixture
def probe(monkeypatch, tmp_path, quick_compiles):
    """Makes the commands use probes, and leaves them in an empty working directory."""
    monkeypatch.setattr("medjax.make", make_probe)
    monkeypatch.setattr("medjax.policies.saved.make", make_probe)
    monkeypatch.setattr("train.runs.finish.BASELINES", {"none": never, "random": coin})
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work
