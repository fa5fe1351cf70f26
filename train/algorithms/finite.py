"""Detects numbers that are no longer finite inside the compiled program, and names them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

BAD = "first_bad"  # metric: index of the first of QUANTITIES that is not finite, or their number
QUANTITIES = (  # that an algorithm may check, in the order in which an update computes them
    "observations",
    "rewards",
    "values",
    "advantages",
    "loss",
    "gradient",
    "parameters",
    "optimizer state",
)


def first_bad(**quantities: Any) -> jax.Array:
    """Finds the first of these trees that holds a number that is not finite.

    Args:
        quantities: trees by their names in `QUANTITIES`, with `_` for a space, and in that order.

    Returns:
        Its index in `QUANTITIES`, () int32; their number if all are finite.
    """

    def is_bad(tree: Any) -> jax.Array:
        leaves = jax.tree.leaves(tree)
        floats = [leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)]
        return jnp.stack([~jnp.all(jnp.isfinite(leaf)) for leaf in floats]).any()

    places = [QUANTITIES.index(name.replace("_", " ")) for name in quantities]
    bad = jnp.stack([*map(is_bad, quantities.values()), jnp.bool_(True)])
    return jnp.asarray([*places, len(QUANTITIES)], jnp.int32)[jnp.argmax(bad)]


def finite_updates(bad: np.ndarray) -> tuple[int, str | None]:
    """Number of updates before the first with a quantity that is not finite, and that quantity (None: all are finite).

    Args:
        bad: metric `BAD` of `(count,)` updates, or `(num_seeds, count)`.
    """
    worst = np.min(np.atleast_2d(bad), axis=0)
    where = np.flatnonzero(worst < len(QUANTITIES))
    return (int(where[0]), QUANTITIES[worst[where[0]]]) if where.size else (worst.size, None)
