"""Shared environments: what is built and compiled once for the whole session."""

import os

import jax
import pytest
from hypothesis import settings

import medjax

# Two devices, whatever the machine: training shares its environments among them.
jax.config.update("jax_num_cpu_devices", 2)

# The same examples in every run; HYPOTHESIS_PROFILE=default draws new ones.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(scope="session")
def paper():
    """The default environment and its numbers."""
    return medjax.make("paper")


@pytest.fixture(scope="session")
def started(paper):
    """A state at reset."""
    env, params = paper
    return jax.jit(env.reset)(jax.random.key(0), params)


@pytest.fixture(scope="module")
def quick_compiles():
    """Programs that run a few steps only: compiled in half the time, and slow.

    They round differently, so none is left for tests that compare bits, nor taken over from them.
    """
    jax.clear_caches()
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
    jax.clear_caches()
