"""Random keys of episodes: episode i of a seed is the same episode in every tool.

An episode's key splits into the streams RESET, STEP and ACT. The reset uses its stream directly; decision t uses
`fold_in(stream, t)`. Every tool can therefore record, draw or replay an episode of `train.evaluate` by its number.
"""

import jax
import jax.numpy as jnp

EVALUATION = 0x0E7A1  # folded into the seed's key to keep evaluation keys apart from training keys
RESET, STEP, ACT = range(3)  # the streams of an episode's randomness


def episode_keys(seed: int, episodes: int, first: int = 0) -> jax.Array:
    """Keys `(episodes,)` of a seed's episodes, starting at number `first`."""
    root = jax.random.fold_in(jax.random.key(seed), EVALUATION)
    numbers = jnp.arange(first, first + episodes, dtype=jnp.uint32)
    return jax.vmap(jax.random.fold_in, (None, 0))(root, numbers)
