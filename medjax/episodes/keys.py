"""Which episode is meant: everything that plays episode i of a seed draws from the same keys.

An episode's key splits into the streams RESET, STEP and ACT. The reset takes its stream as it is; decision t draws from
`fold_in(stream, t)`. So an episode of `train.evaluate` is the one that is recorded, drawn or played by hand.
"""

import jax
import jax.numpy as jnp

EVALUATION = 0x0E7A1  # folded into the seed's key, so that evaluation shares no key with training
RESET, STEP, ACT = range(3)  # the streams of an episode's randomness


def episode_keys(seed: int, episodes: int, first: int = 0) -> jax.Array:
    """Keys `(episodes,)` of a seed's episodes, from number `first` on."""
    root = jax.random.fold_in(jax.random.key(seed), EVALUATION)
    numbers = jnp.arange(first, first + episodes, dtype=jnp.uint32)
    return jax.vmap(jax.random.fold_in, (None, 0))(root, numbers)
