"""Shared environments: what is built and compiled once for the whole session."""

import jax
import pytest

import medjax


@pytest.fixture(scope="session")
def paper():
    """The default environment and its numbers."""
    return medjax.make("paper")


@pytest.fixture(scope="session")
def started(paper):
    """A state at reset."""
    env, params = paper
    return jax.jit(env.reset)(jax.random.key(0), params)
