"""A run goes on with the random numbers that it began with."""

import jax

from tests.train.conftest import TINY, refused
from train import ppo


def test_another_prng_is_named(probe, capsys):
    """Its keys are of another size, and no setting of the run says why."""
    assert ppo.main([*TINY, "--eval-episodes=0", "--run-dir=run"]) == 0
    capsys.readouterr()
    with jax.default_prng_impl("rbg"):
        words = "jax_default_prng_impl, which is rbg", "(4,) uint32"
        refused(capsys, ["--resume=run", "--total-timesteps=192"], *words)
