"""Numbers that are no longer finite: found in the compiled program, and named."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

BAD = "first_bad"  # metric: index of the first of QUANTITIES that is not finite, their number if all are
QUANTITIES = (  # in the order in which an update computes them
    "observations",
    "rewards",
    "values",
    "advantages",
    "loss",
    "gradient",
    "parameters",
    "optimizer state",
)


def first_bad(*quantities: Any) -> jax.Array:
    """Index of the first of these trees with a number that is not finite, () int32; their count if there is none."""

    def is_bad(tree: Any) -> jax.Array:
        floats = [
            leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)
        ]
        return jnp.stack([~jnp.all(jnp.isfinite(leaf)) for leaf in floats]).any()

    bad = jnp.stack([*map(is_bad, quantities), jnp.bool_(True)])
    return jnp.argmax(bad).astype(jnp.int32)


def finite_updates(bad: np.ndarray) -> tuple[int, str | None]:
    """Updates before the first in which something is not finite, and what that is.

    Args:
        bad: metric `BAD` of `(count,)` updates, or `(num_seeds, count)`.
    """
    worst = np.min(np.atleast_2d(bad), axis=0)
    where = np.flatnonzero(worst < len(QUANTITIES))
    return (int(where[0]), QUANTITIES[worst[where[0]]]) if where.size else (worst.size, None)
