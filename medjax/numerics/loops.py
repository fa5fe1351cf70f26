"""A loop that computes before its first pass what no pass changes.

XLA for CPUs moves such numbers out of a loop by itself. XLA for GPUs launches a program for many of them in every pass
(`findings/xla-gpu-keeps-loop-invariants.sh`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun

MOST = 64  # numbers of an array that is computed before the loop; reading a larger one costs more than computing it


def scan(body: Callable[[Any, Any], tuple[Any, Any]], init: Any, xs: Any) -> tuple[Any, Any]:
    """`jax.lax.scan(body, init, xs)`; on a GPU the body computes only what its arguments change, and large arrays.

    Args:
      body: `(carry, x)` to `(carry, y)`, as in `jax.lax.scan`.
      init: the first carry, any pytree.
      xs: pytree of arrays, whose first axis is scanned over.
    """
    if jax.default_backend() == "cpu":
        return jax.lax.scan(body, init, xs)
    x = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), xs)
    traced, shape = jax.make_jaxpr(body, return_shape=True)(init, x)
    before, within = _split(traced.jaxpr)
    fixed = traced.consts + jaxpr_as_fun(ClosedJaxpr(before, ()))(*traced.consts)
    rest = jaxpr_as_fun(ClosedJaxpr(within, ()))

    def remaining(carry: Any, x: Any) -> tuple[Any, Any]:
        """A pass that reads what was computed before."""
        leaves = rest(*fixed, *jax.tree.leaves((carry, x)))
        made: tuple[Any, Any] = jax.tree.unflatten(jax.tree.structure(shape), leaves)
        return made

    return jax.lax.scan(remaining, init, xs)


def _split(traced: Jaxpr) -> tuple[Jaxpr, Jaxpr]:
    """What to compute before the loop, from a body's constants, and the rest of it.

    The rest takes the constants, what was computed before, and the arguments of the body.
    """
    known: set[Var] = {*traced.constvars}
    before, within = [], []
    for equation in traced.eqns:
        made: list[Any] = [each.aval for each in equation.outvars]
        fixed = all(isinstance(atom, Literal) or atom in known for atom in equation.invars)
        if fixed and all(each.size <= MOST for each in made) and not equation.effects:
            before.append(equation)
            known.update(equation.outvars)
        else:
            within.append(equation)
    read = {atom for equation in within for atom in equation.invars if isinstance(atom, Var)}
    read.update(atom for atom in traced.outvars if isinstance(atom, Var))
    kept = [atom for equation in before for atom in equation.outvars if atom in read]
    first, rest = [*traced.constvars], [*traced.constvars, *kept, *traced.invars]
    return (
        traced.replace(constvars=[], invars=first, outvars=kept, eqns=before),
        traced.replace(constvars=[], invars=rest, eqns=within),
    )
