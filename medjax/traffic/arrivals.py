"""Who arrives at each entry, and when: the same in an episode whatever dispatchers and drivers do.

The n-th vehicle at an entry draws from keys of the episode, the entry and n, and so do the counts of each round of
entries. What happens on the road delays vehicles; it never exchanges them for others, so that two policies on one
episode meet the same traffic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from medjax.world.state import EnvState


class Traits(NamedTuple):
    """What is random about vehicles that enter, `(K,)` each."""

    speed: jax.Array  # standard normal; all others are uniform in [0, 1)
    is_ev: jax.Array
    kind: jax.Array
    destination: jax.Array
    charge: jax.Array
    complies: jax.Array


def new_seed(key: jax.Array) -> jax.Array:
    """A seed of all arrivals of an episode, `(2,)` uint32, for `EnvState.arrivals`."""
    return jax.random.bits(key, (2,), jnp.uint32)


def redraw(key: jax.Array, state: Any) -> Any:
    """The state of an environment, wrapped or not, with another future: nobody on the road changes, who comes does."""

    def is_highway(node: Any) -> bool:
        return isinstance(node, EnvState)

    def drawn(node: Any) -> Any:
        return node.replace(arrivals=new_seed(key)) if is_highway(node) else node

    return jax.tree.map(drawn, state, is_leaf=is_highway)


def _stream(seed: jax.Array, stream: jax.Array | int, number: jax.Array) -> jax.Array:
    """The key of the number-th draw of a stream."""
    key = jax.random.wrap_key_data(seed, impl="threefry2x32")
    return jax.random.fold_in(jax.random.fold_in(key, stream), number)


def draw_traits(seed: jax.Array, stream: jax.Array, number: jax.Array) -> Traits:
    """Traits of vehicles by stream, one an entry and one for all MEDs, and number in it, `(K,)` int32 each."""

    def one(stream: jax.Array, number: jax.Array) -> Traits:
        normal_key, uniform_key = jax.random.split(_stream(seed, stream, number))
        uniform = jax.random.uniform(uniform_key, (len(Traits._fields) - 1,), jnp.float32)
        return Traits(jax.random.normal(normal_key, (), jnp.float32), *uniform)

    return jax.vmap(one)(stream, number)


def draw_round(seed: jax.Array, num_entries: int, number: jax.Array) -> jax.Array:
    """Uniform draws of how many vehicles come to each entry in a round, `(num_entries,)`."""
    # Streams 0 to num_entries are those of vehicles.
    return jax.random.uniform(_stream(seed, num_entries + 1, number), (num_entries,), jnp.float32)
