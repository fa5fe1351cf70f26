"""Numbers that are no longer finite: found in the compiled program, and named."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

BAD = "first_bad"  # metric: index of the first of QUANTITIES that is not finite, their number if all are
QUANTITIES = (  # that an algorithm may have, in the order in which an update computes them
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
    """The first of these trees with a number that is not finite.

    Args:
        quantities: by their names in `QUANTITIES`, with `_` for a space, in the order of these.

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
    """Updates before the first in which something is not finite, and what that is.

    Args:
        bad: metric `BAD` of `(count,)` updates, or `(num_seeds, count)`.
    """
    worst = np.min(np.atleast_2d(bad), axis=0)
    where = np.flatnonzero(worst < len(QUANTITIES))
    return (int(where[0]), QUANTITIES[worst[where[0]]]) if where.size else (worst.size, None)
