"""A run resumes only with the random number generator that it started with."""

import jax
import pytest

from tests.train.conftest import TINY, refused
from train import ppo


@pytest.mark.thorough
def test_another_prng_is_named(probe, capsys):
    """With keys of the same size or of another one, also if a setting changes at the same time."""
    with jax.default_prng_impl("rbg"):
        assert ppo.main([*TINY, "--eval-episodes=0", "--run-dir=run"]) == 0
    capsys.readouterr()
    for other in ("threefry2x32", "unsafe_rbg"):
        with jax.default_prng_impl(other):
            words = f"jax_default_prng_impl {other}, allowed: rbg", "checkpoints"
            refused(capsys, ["--resume=run", "--total-timesteps=192", "--lr=0.01"], *words)
