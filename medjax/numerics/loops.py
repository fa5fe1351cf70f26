"""A loop that computes before its first pass what no pass changes.

XLA for CPUs moves such numbers out of a loop by itself. XLA for GPUs launches a program for many of them in every pass
(`findings/xla-gpu-keeps-loop-invariants.sh`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun

# Of an array that is computed before the loop, under `vmap` of one environment. To read a larger one in every pass
# costs more than to compute it there.
MOST_NUMBERS = 64


def scan(body: Callable[[Any, Any], tuple[Any, Any]], init: Any, xs: Any) -> tuple[Any, Any]:
    """Gives what `jax.lax.scan(body, init, xs)` gives.

    Except on a CPU, it computes once, before the loop, each small array that follows from constants of the body alone.

    Args:
      body: `(carry, x)` to `(carry, y)`.
      init: the first carry, a pytree of arrays.
      xs: pytree of arrays; the loop goes over their first axis.

    Returns:
      (the last carry, every y along a new first axis).

    Raises:
      TypeError: as `jax.lax.scan`, e.g. for a carry whose type changes.
    """
    on_cpu = jax.default_backend() == "cpu"
    if on_cpu or not all(map(_keeps_its_type, jax.tree.leaves((init, xs)))):
        return jax.lax.scan(body, init, xs)
    x = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), xs)
    traced, shape = jax.make_jaxpr(body, return_shape=True)(init, x)
    before, within = _split(traced.jaxpr)
    computed = jaxpr_as_fun(ClosedJaxpr(before, ()))(*traced.consts)
    one_pass = jaxpr_as_fun(ClosedJaxpr(within, ()))

    def remaining(carry: Any, x: Any) -> tuple[Any, Any]:
        """A pass that reads what was computed before."""
        leaves = one_pass(*traced.consts, *computed, *jax.tree.leaves((carry, x)))
        made: tuple[Any, Any] = jax.tree.unflatten(jax.tree.structure(shape), leaves)
        return made

    return jax.lax.scan(remaining, init, xs)


def _keeps_its_type(leaf: Any) -> bool:
    """Whether `lax.scan` takes the leaf as it is: it may promote a weak type, and then traces the body again.

    Under `jax.shard_map` a leaf may also vary over devices, which the type of a slice of it would have to say.
    """
    kind = jax.typeof(leaf)
    return not (getattr(kind, "weak_type", False) or getattr(kind, "vma", None))


def _split(traced: Jaxpr) -> tuple[Jaxpr, Jaxpr]:
    """What to compute before the loop, from a body's constants, and the rest of the body.

    The rest takes the constants, what was computed before, and the arguments of the body.
    """
    known: set[Var] = {*traced.constvars}
    before, within = [], []
    for equation in traced.eqns:
        kinds: list[Any] = [made.aval for made in equation.outvars]
        moves = not equation.effects and all(kind.size <= MOST_NUMBERS for kind in kinds)
        if moves and all(isinstance(atom, Literal) or atom in known for atom in equation.invars):
            before.append(equation)
            known.update(equation.outvars)
        else:
            within.append(equation)
    read = {atom for equation in within for atom in equation.invars if isinstance(atom, Var)}
    read.update(atom for atom in traced.outvars if isinstance(atom, Var))
    kept = [made for equation in before for made in equation.outvars if made in read]
    constants = [*traced.constvars]
    return (
        traced.replace(constvars=[], invars=constants, outvars=kept, eqns=before),
        traced.replace(constvars=[], invars=[*constants, *kept, *traced.invars], eqns=within),
    )
