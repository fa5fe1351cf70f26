"""Observation and action spaces, in the style of gymnax."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp


@dataclasses.dataclass(frozen=True)
class Discrete:
    """Actions 0 .. n - 1."""

    n: int
    shape: tuple[int, ...] = ()
    dtype: type = jnp.int32

    def sample(self, key: jax.Array) -> jax.Array:
        """A uniform action, () int32."""
        return jax.random.randint(key, self.shape, 0, self.n, self.dtype)

    def contains(self, value: jax.Array) -> jax.Array:
        """Whether value is an action, () bool."""
        return (value >= 0) & (value < self.n)


@dataclasses.dataclass(frozen=True)
class Box:
    """Real arrays of one shape within [low, high]."""

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: type = jnp.float32

    def sample(self, key: jax.Array) -> jax.Array:
        """A uniform array within the bounds; standard normal if either bound is infinite."""
        if abs(self.low) == float("inf") or abs(self.high) == float("inf"):
            return jax.random.normal(key, self.shape, self.dtype)
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, value: jax.Array) -> jax.Array:
        """Whether every element lies within the bounds, () bool."""
        return jnp.all((value >= self.low) & (value <= self.high))
