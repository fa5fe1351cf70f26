"""Arrivals at each entry, which do not depend on what dispatchers and drivers do.

The n-th vehicle at an entry draws its traits from a key of episode, entry and n, and each round of entries draws its
counts likewise. Events on the road delay vehicles but never change them, so two policies meet the same traffic in an
episode.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from medjax.traffic.demand import surge_starts
from medjax.world.params import EnvConfig, EnvParams
from medjax.world.state import EnvState

# The stream of incidents, far from those of vehicles and rounds.
INCIDENTS = 2**31


class Traits(NamedTuple):
    """Random traits of entering vehicles, `(K,)` each."""

    speed: jax.Array  # standard normal; all other fields are uniform in [0, 1)
    is_ev: jax.Array
    kind: jax.Array
    destination: jax.Array
    charge: jax.Array
    complies: jax.Array
    sees_queues: jax.Array


def new_seed(key: jax.Array) -> jax.Array:
    """Seed of all arrivals of an episode, `(2,)` uint32, for `EnvState.arrivals`."""
    return jax.random.bits(key, (2,), jnp.uint32)


def redraw(key: jax.Array, state: Any, config: EnvConfig, params: EnvParams) -> Any:
    """Redraws what has yet to arrive in one environment; `jax.vmap` takes it to a batch.

    Vehicles on the road stay as they are. A surge that has begun stays, too. Any other surge gets a ramp and a start
    anew, uniform over the time that is left. All incidents are drawn anew, whether they have happened or not.

    Args:
      key: random key.
      state: state of an environment, wrapped or not.
      config: sizes and time steps of the highway.
      params: of the highway, the second result of `env.highway(state, params)`.

    Returns:
      The state with other arrivals.
    """

    def anew(state: EnvState) -> EnvState:
        seed, surges = new_seed(key), state.surges
        if surges is not None:
            surges = _later_surges(surges, draw_surges(seed, config), state, config, params)
        return state.replace(arrivals=seed, surges=surges)

    return jax.tree.map(
        lambda node: anew(node) if isinstance(node, EnvState) else node,
        state,
        is_leaf=lambda node: isinstance(node, EnvState),
    )


def _later_surges(
    surges: jax.Array, drawn: jax.Array, state: EnvState, config: EnvConfig, params: EnvParams
) -> jax.Array:
    """`surges`; `drawn` replaces those that have not begun, and begins later. All are `(num_surges, 2)`."""
    demand = params.demand
    span = demand.surge_until_s - demand.surge_from_s
    # Surges count at the starts of rounds. The last one that was played began a round ago.
    last_s = state.time * config.decision_s - config.round_s
    gone = jnp.clip((last_s - demand.surge_from_s) / jnp.where(span > 0.0, span, 1.0), 0.0, 1.0)
    later = drawn.at[:, 0].set(gone + drawn[:, 0] * (1.0 - gone))
    has_begun = surge_starts(surges, demand) <= last_s
    return jnp.where(has_begun[:, None], surges, later)


def _stream(seed: jax.Array, stream: jax.Array | int, number: jax.Array) -> jax.Array:
    """The key of the number-th draw of a stream."""
    key = jax.random.wrap_key_data(seed, impl="threefry2x32")
    return jax.random.fold_in(jax.random.fold_in(key, stream), number)


def draw_traits(seed: jax.Array, stream: jax.Array, number: jax.Array) -> Traits:
    """Traits by stream (one per entry and one for all MEDs) and by number within it, `(K,)` int32 each."""

    def one(stream: jax.Array, number: jax.Array) -> Traits:
        normal_key, uniform_key = jax.random.split(_stream(seed, stream, number))
        uniform = jax.random.uniform(uniform_key, (len(Traits._fields) - 2,), jnp.float32)
        # A key of its own leaves the other traits as they were before this one existed.
        sees = jax.random.uniform(jax.random.fold_in(uniform_key, 0), (), jnp.float32)
        return Traits(jax.random.normal(normal_key, (), jnp.float32), *jnp.append(uniform, sees))

    return jax.vmap(one)(stream, number)


def draw_surges(seed: jax.Array, config: EnvConfig) -> jax.Array:
    """Uniform draws for the time and the ramp of each surge of demand, `(num_surges, 2)`."""
    # Vehicles use streams 0 to num_entries, and counts the next one.
    key = _stream(seed, config.num_entries + 2, jnp.zeros((), jnp.int32))
    return jax.random.uniform(key, (config.num_surges, 2), jnp.float32)


def draw_round(seed: jax.Array, num_entries: int, number: jax.Array) -> jax.Array:
    """Uniform draws for the arrival counts of a round, `(num_entries,)`."""
    # Vehicles use streams 0 to num_entries.
    return jax.random.uniform(_stream(seed, num_entries + 1, number), (num_entries,), jnp.float32)


def draw_incidents(seed: jax.Array, count: int) -> jax.Array:
    """Uniform draws for the time and place of each incident, `(count, 2)`; they do not depend on the count."""

    def one(number: jax.Array) -> jax.Array:
        return jax.random.uniform(_stream(seed, INCIDENTS, number), (2,), jnp.float32)

    return jax.vmap(one)(jnp.arange(count, dtype=jnp.int32))
