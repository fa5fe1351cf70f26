"""The commands, on a probe environment."""

import jax
import jax.numpy as jnp
import pytest

from medjax.errors import InputError
from medjax.policies.policy import rule
from medjax.scenarios import Recipe
from tests.train.probe_envs import Probe, ProbeParams
from train import ppo

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
        raise InputError(f"unknown scenario {name!r}: allowed follow, noisy")
    for option, value in overrides.items():
        if option not in ("episode_decisions", "reward"):
            raise InputError(f"unknown option {option!r}: allowed episode_decisions, reward")
        if not isinstance(value, int | float) or not 0 < value < 100:
            raise InputError(f"{option} is {value}, allowed: above 0, below 100")
    recipe = Recipe(name, overrides, None, observation)
    return Probe(name, recipe=recipe), ProbeParams(**overrides)


def never(env):
    return rule(lambda key, state, params: jnp.int32(0), env.num_actions)


def coin(env):
    return rule(
        lambda key, state, params: jax.random.randint(key, (), 0, 2, jnp.int32), env.num_actions
    )


STAND_INS = {
    "medjax.make": make_probe,
    "medjax.policies.about.make": make_probe,
    "medjax.policies.saved.make": make_probe,
    "medjax.policies.team.BASELINES": {"none": never, "random": coin},
}


def use_probes():
    """Makes the commands use probes for the rest of this process."""
    patch = pytest.MonkeyPatch()
    for name, stand_in in STAND_INS.items():
        patch.setattr(name, stand_in)


@pytest.fixture
def probe(monkeypatch, tmp_path, quick_compiles):
    """Makes the commands use probes, and leaves them in an empty working directory."""
    for name, stand_in in STAND_INS.items():
        monkeypatch.setattr(name, stand_in)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work


def exit_code(command, argv):
    try:
        return command.main(argv)
    except SystemExit as ended:
        return ended.code


def refused(capsys, argv, *words, command=ppo):
    assert exit_code(command, argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    for word in words:
        assert word in err
    return err
